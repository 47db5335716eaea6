"""The bench in a browser: ``tiltcal app``. Pages over the commands and the Python interface, with
no calculation of their own: what takes long is a command in a process of its own, and every action
is shown as that command. Loaded by ``tiltcal app`` only; NiceGUI is an extra.
"""
