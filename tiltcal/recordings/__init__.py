"""Recordings: files, imports, dwells and moves found in them, poses, and their readout played
again.
"""
