"""Algorithms that run sample by sample, and how they are judged."""
