"""The verb `data`: the published data sets of the protocols.

known.yaml       where they are published, and digests of their cameras, names and photographs
verification.py  compares a folder with them
building.py      writes what a protocol makes of a folder
"""
