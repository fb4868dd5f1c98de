"""Cameras from photographs. In the order of their work:

    structure_from_motion   tries the kinds of matches until one places every photograph
    matching                kinds of matches: SIFT, pooled SIFT, the networks of learned_matches
    mapping                 cameras from matches, by several methods; or those of a prior (network_start)
    support                 removes photographs that matches (two_view) or pictures (dense.check) contradict
    dense.refinement        exact cameras: focal_lengths, altered_lenses, dense.matches, bundle_adjustment

colmap.py has all calls of COLMAP, thresholds.py all thresholds.
"""
