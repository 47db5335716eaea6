"""Figures that `make bench` prints: accuracy against bounds, speed as ratios in one run, memory as
peak RSS.
"""
