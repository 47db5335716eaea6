"""Recordings of the five source systems, clean and with one fault each, by a generator of its own:
numpy only, no code of the product.
"""
