"""What stands in the laboratory and what it is asked to do: site, rig, sensors, sequences,
trajectories.
"""
