"""World-to-camera matrices from what files of cameras hold instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


def pose_from_opengl(matrix: ArrayLike, where: str) -> NDArray[np.float64]:
    """Turn a `[4, 4]` OpenGL camera-to-world matrix into the world-to-camera one of `Camera`.

    NeRF data sets write poses so; the camera's axes are right, up, backwards.

    The rotation is inverted by transposing it; that it is one, `Camera` checks.

    Raises:
        SceneError: the last row is not 0 0 0 1.
    """
    import numpy as np

    pose = np.asarray(matrix, dtype=np.float64)
    if not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise SceneError(
            f"the last row of the pose is {pose[3].tolist()}, not 0 0 0 1",
            where=where,
            fix="write 4x4 camera-to-world matrices, one row after the other",
        )
    return pose_from_axes(pose[:3, 0], -pose[:3, 1], -pose[:3, 2], pose[:3, 3])


def pose_from_axes(
    right: NDArray[np.float64],
    down: NDArray[np.float64],
    forward: NDArray[np.float64],
    center: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The world-to-camera matrix `[4, 4]` of a camera given by its axes and centre in the world."""
    import numpy as np

    rotation = np.stack([right, down, forward])
    result = np.eye(4)
    result[:3, :3] = rotation
    with np.errstate(over="ignore", invalid="ignore"):  # Camera refuses what is not finite
        result[:3, 3] = -rotation @ center
    return result
