"""The set-up of a laboratory and what it is asked to do: site, rig, tables, sensors, sequences,
trajectories.
"""
