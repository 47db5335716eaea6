"""What a program calls: ``import tiltcal as tc`` names what stands here; the commands call the
same.
"""
