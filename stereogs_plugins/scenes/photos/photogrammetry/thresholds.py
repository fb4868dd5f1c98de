"""Thresholds of the estimation of cameras, with units and the measurements behind them.

Pixels are those of the photographs for camera estimation (`matching_size`), unless a line says otherwise.
"""

from typing import NamedTuple

# Photographs
MIN_PHOTOS = 3
"""Least photographs, except for two with known focal lengths: two do not determine it."""
FOCAL_RANGE = (0.5, 4.0)
"""Plausible focal lengths without EXIF, in units of the longer side."""
EXIF_FOCAL_RANGE = (0.2, 20.0)
"""Accepted focal lengths in EXIF, in units of the longer side."""
FOCAL_FACTOR = 3.0
"""Plausible ratio to the focal length by EXIF and its inverse. Cropping does not change EXIF."""
NEAR_EXIF = 1.5
"""Ratio to the focal length by EXIF, or its inverse, from which one of the two is probably wrong."""
MAX_DISTORTION = 1.0
"""Largest radial term k1; beyond it the picture would fold before its corners."""


# Matches
class Trust(NamedTuple):
    """Matches that connect two photographs without a look at the pictures.

    Args:
        in_triangle: least number, if a third photograph has as many with both.
        alone: least number without a third photograph.
    """

    in_triangle: int
    alone: int


MAX_ERROR = 2.0
"""Largest error of matches and points, pixels; COLMAP's 4 is meant for much larger photographs."""
MIN_MATCHES = 15
"""Least number of matches that support a pair."""
MIN_CHECKED = 30
"""Matches that connect two photographs if the pictures confirm it (dense/check.py). Fewer are inexact: once,
cameras were off by ten degrees along the epipolar lines, which pictures do not show."""
SIFT_TRUST = Trust(MIN_MATCHES, 60)
LEARNED_TRUST = Trust(150, 200)
"""Networks also match unrelated pictures (20 to 60 matches, of which a part fits any geometry) and opposite
sides of symmetric objects (up to 180, in triangles too, but there one of the pairs had fewer than 140)."""
ALWAYS_CHECKED = Trust(2**31, 2**31)
"""Two photographs fit any geometry that a wrong focal length implies."""
MIN_SUPPORT = 0.9
"""Least share of the matches of a pair that agree with a model; correct ones have 0.95 or more in general."""
MIN_IN_FRONT = 0.25
"""Least share of the matches of a pair in front of both cameras; without parallax half are, by chance."""
MIN_SHARED = 3
"""Points that give two parts of a model the same scale. Three correct models had 6 or more; one had none, and
positions wrong by 44 % of their spread."""
FIRST_PAIR_DEGREES = (16.0, 2.0)
"""Triangulation angles of the first pair to try: COLMAP's own, and one for forward-facing photographs."""
START_ROUNDS = ((8.0, 0.1), (4.0, 0.025), (2.0, 0.0))
"""Errors of matches that are tolerated in turn while they refine a network's cameras: of rays in degrees, and
of positions in units of the longer side, at least `MAX_ERROR`. Cameras of a room that were off by ten degrees
and half a baseline ended where exact ones do."""

# Keypoints and matches of networks
MIN_SCORE = 0.1
"""Least score of a match; geometric verification removes the remaining wrong ones."""
KEYPOINT_SIZE, MAX_ENLARGED = 1024, 2.0
"""Longer side of the pictures that ALIKED sees, in pixels, and the largest factor of enlargement."""
MAX_KEYPOINTS = 1024
"""Keypoints of a picture to match, best first; matching twice as many takes four times as long."""

# Pairs without depth
MIN_DEVIATION = 0.015
"""Least deviation of the singular values of K^-1 H K from 1 if H is not from a rotation."""
MIN_OFF_SURFACE = 0.01
"""Share of matches that agree with the cameras and not with the homography. Pictures without depth had 0.002
at most, neighbouring frames of a video with depth 0.02 to 0.1."""
TRIED_FOCALS = (0.7, 1.6, 10)
"""Shortest and longest focal length in units of the longer side, and number of those to try."""

# Depth of pairs by plane sweep; pixels of the reduced photographs
PLANES = 64
"""Depths to compare."""
PENALTIES = (10, 4000)
"""Semi-global matching's costs of small and of large changes of depth between pixels."""
RADIUS = 2
"""Radius of the windows, in pixels."""
DEPTH_PERCENTILES, DEPTH_MARGINS = (2, 98), (1 / 1.25, 1.5)
"""Percentiles of the depths of points, and factors that widen this range."""
MAX_RETURN = 1.0
"""Largest distance of a confirmed pixel from where its point returns to, in pixels."""
MIN_CORRELATION = 0.6
"""Least correlation of the windows around a pixel and where it appears in the other photograph."""
MIN_CONTRAST = 4 / 255
"""Standard deviation of grey values in a window that can be recognized."""
FLAT_VARIANCE = 1e-5
"""Variance that is added to those of windows, so that noise on a flat surface does not correlate."""

# Dense check
CHECK_SIZE = 240
"""Longer side of the pictures that are compared, in pixels."""
MIN_ADVANTAGE = 1.5
"""Least ratio of confirmed pixels to those confirmed by chance. Of 24 correct pairs up to 65 degrees apart
with 48 to 223 matches, 20 had 1.5 to 2.8. Eleven wrong ones had 0.9 to 1.3, one 23 degrees off 1.45."""
DISPLACEMENT = 0.03
"""Displacement for chance, in units of the longer side; larger than a window."""
RARE = 0.003
"""Share of pixels that is added to both sides of the ratio, which is not meaningful for fewer."""

# Dense matches
DEPTH_SIZE, FLOW_SIZE = 320, 800
"""Longer sides of the photographs for depth and for optical flow, in pixels."""
MAX_PARTNERS = 4
"""Photographs that each one is matched with at least, those that share most points."""
MAX_CORNERS, MAX_CORNERS_OF_PHOTO = 4800, 800
"""Corners of all photographs, and of each one."""
CORNER_QUALITY, CORNER_DISTANCE = 0.005, 4
"""Least strength of a corner in units of the strongest, and distance of corners in pixels."""
FLOW_WINDOW, MAX_FLOW, MAX_FLOW_ERROR = 15, 6.0, 0.3
"""Window of the optical flow, the longest flow, and the largest error of flow there and back, in pixels."""
CONFIRMED_WINDOW = 5
"""Side, in pixels, of the window in which depth must be confirmed."""

# Refinement
MAX_REFINED = 24
"""More photographs determine the cameras without dense matches, which would take long."""
HELD_OUT_EVERY = 4
"""One of as many matches takes no part in the adjustment and judges it."""
LOSS_SCALE = 0.5
"""Error in pixels from which the soft L1 loss is linear. Half of the matches are exact to 0.15 pixels."""
OTHER_FOCAL, MIN_INCREASE = 1.25, 1.05
"""The points determine the focal length if a change by this factor increases the cost by that factor."""
MIN_CONTRADICTION = 1.2
"""Least increase of the cost by wrong focal lengths in EXIF. In ten sets of three, true ones increased it
by a factor of up to 1.12; in nine of them, those 4 times as long or short by 1.24 at least."""

# Zoomed and cropped photographs
MIN_TO_COMPARE = 4
"""Photographs that show whether one of them was zoomed."""
MIN_ZOOM = 1.15
"""Least ratio of a zoomed photograph's focal length to the median, or its inverse; others have up to 1.06."""
MIN_SHIFT, MIN_FALL = 0.03, 1.025
"""Least shift of the principal point of a photograph cropped off centre, in units of width or height, and
least factor by which it reduces the cost. Others shifted by 0.01 at most, with factors up to 1.08."""
CENTRE_ROUNDS = 4
"""Adjustments of a principal point and of the other lenses in turn."""
FOCAL_STARTS = (1.0, 0.7, 0.5)
"""Factors of initial focal lengths, which are often much too long if a photograph is cropped off centre."""

# Explanations of photographs that do not connect
FEW_FEATURES = 100
"""A photograph with fewer features is blurred, dark, or of a plain surface."""
ENOUGH_MATCHES = 30
"""Matches that COLMAP needs to add a photograph (`abs_pose_min_num_inliers`)."""
MANY_MATCHES = 200
"""Photographs with this many matches overlap; if they do not connect, there is another reason."""
