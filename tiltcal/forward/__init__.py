"""The forward model: table angles to readings, in closed form, with its linearisation and its
Jacobian.
"""
