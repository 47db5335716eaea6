"""tiltsim: the laboratory. Motion in, Recording out; the only package that imports mujoco.

``rig`` builds the model, ``motion`` reads prescribed motion exactly, ``dynamics`` runs it by time
steps, ``laboratory`` makes recordings of both.
"""
