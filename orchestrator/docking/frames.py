"""Motion mapping between satellites and simulator, Eqs. (1), (2) and (10) to (16), for recorded motions.

Names as in the paper's Table 1: A service satellite, B target, Ai and Bi their assembly frames, u = 6 the
robot's end, t the target's assembly frame in the laboratory. A transformation a_T_b takes coordinates of b to
a; T_b alone takes them to the global frame. Quaternions are scalar first. What FMUs need of this lies in
fmus/shared/free_bodies.py; fmus/SatellitePair/README.md lists the misprints, which are corrected alike here:

- Eq. (13) prints T_Ai^-1 T_Bi, which is Ai_T_Bi. Bi_T_Ai = T_Bi^-1 T_Ai is meant: Eq. (14) needs it.
- Eqs. (12), (16) print R_B^-1 where R_Bi^-1 is meant, and leave out that Bi turns: its frame carries the
  point of A along at omega_Bi x (r_Ai - r_Bi).
- Below Eq. (15) omega and v have changed places in the text.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..base.arrays import Array


@dataclass(frozen=True)
class Motion:
    """Pose and twist of a frame, resolved in the frame that they are given in.

    Attributes:
        position: of the origin, shape (3,) or (n, 3) [m].
        orientation: turns the frame's coordinates into those of the one it is given in; one or n.
        velocity: of the origin [m/s], shape as `position`.
        angular_velocity: [rad/s], shape as `position`.
    """

    position: Array
    orientation: Rotation
    velocity: Array
    angular_velocity: Array

    @classmethod
    def of(
        cls, position: ArrayLike, quaternion: ArrayLike, velocity: ArrayLike, angular_velocity: ArrayLike
    ) -> Motion:
        """From arrays as FMUs give them: [m], scalar first [1], [m/s], [rad/s]; (3,) and (4,), or n rows.

        Raises: ValueError if a quaternion is not of unit length within 1e-6, or shapes do not fit.
        """
        numbers = np.asarray(quaternion, dtype=float)
        parts = [np.asarray(part, dtype=float) for part in (position, velocity, angular_velocity)]
        shape = (*numbers.shape[:-1], 3)
        if numbers.shape[-1:] != (4,) or any(part.shape != shape for part in parts):
            got = ", ".join(str(part.shape) for part in (parts[0], numbers, *parts[1:]))
            raise ValueError(f"motion: shapes {got}; allowed: (3,), (4,), (3,), (3,), or n rows of each")
        lengths = np.linalg.norm(numbers, axis=-1)
        if np.any(np.abs(lengths - 1.0) > 1e-6):
            worst = float(np.ravel(lengths)[np.argmax(np.abs(np.ravel(lengths) - 1.0))])
            raise ValueError(f"motion: a quaternion has the length {worst!r}; allowed: 1 within 1e-6")
        return cls(parts[0], Rotation.from_quat(numbers, scalar_first=True), parts[1], parts[2])

    @classmethod
    def still(cls, position: ArrayLike, orientation: Rotation) -> Motion:
        """A frame at rest, as O_t is in the laboratory, Eq. (15); position [m], shape (3,)."""
        return cls(np.asarray(position, dtype=float), orientation, np.zeros(3), np.zeros(3))


def attached(body: Motion, position: ArrayLike, orientation: Rotation) -> Motion:
    """Motion of a frame fixed to a body, Eqs. (10) and (11).

    Args:
        body: of the COG frame.
        position: of the frame's origin in the COG frame, shape (3,) [m].
        orientation: of the frame in the COG frame.
    """
    return placed(body, Motion.still(position, orientation))


def relative(of: Motion, to: Motion) -> Motion:
    """Motion of one frame as seen from another, Eqs. (12) and (13): Bi_T_Ai of Ai and Bi."""
    distance = of.position - to.position
    velocity = of.velocity - to.velocity - np.cross(to.angular_velocity, distance)
    back = to.orientation.inv()
    return Motion(
        back.apply(distance),
        back * of.orientation,
        back.apply(velocity),
        back.apply(of.angular_velocity - to.angular_velocity),
    )


def placed(frame: Motion, within: Motion) -> Motion:
    """Global motion of what moves as `within` as seen from `frame`; the inverse of `relative`.

    With O_t at rest and Bi_T_Ai, which is t_T_u by Eq. (1), the command of the robot: Eqs. (14) to (16).
    """
    turn = frame.orientation
    distance = turn.apply(within.position)
    return Motion(
        frame.position + distance,
        turn * within.orientation,
        frame.velocity + np.cross(frame.angular_velocity, distance) + turn.apply(within.velocity),
        frame.angular_velocity + turn.apply(within.angular_velocity),
    )
