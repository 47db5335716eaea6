"""Designing sequences: the poses, dwells and order that tell most about the parameters of interest
per table time.
"""
