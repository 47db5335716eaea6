"""Designing sequences: the poses, dwells and order with the most information on the parameters of
interest per table time.
"""
