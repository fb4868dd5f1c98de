"""Depth of pairs of photographs by plane sweep: it checks estimated cameras and refines them."""
