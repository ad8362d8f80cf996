"""Rotations: unit quaternions (Hamilton, scalar first, B to N), ZYX Euler angles, and their kinematics.

References
----------
J. Diebel, Representing Attitude: Euler Angles, Unit Quaternions, and Rotation Vectors, 2006. Its formulas are for the
inverse rotation and are transposed here: `q_NB` takes components in B to N.
"""

import math

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.elementary import arctan2, sin_cos
from firmware_model.types import Quaternion, Vector

Matrix = tuple[Vector, Vector, Vector]


@kernel
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product `a b`: the rotation `b` followed by `a`."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@kernel
def normalize(q: Quaternion) -> Quaternion:
    """Return `q` at unit length."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return scale * q[0], scale * q[1], scale * q[2], scale * q[3]


@kernel
def rotate(q_NB: Quaternion, v_B: Vector) -> Vector:
    """Return the components in N of a vector given in B; with the conjugate of `q_NB`, from N to B."""
    w, x, y, z = q_NB
    t0 = 2.0 * (y * v_B[2] - z * v_B[1])
    t1 = 2.0 * (z * v_B[0] - x * v_B[2])
    t2 = 2.0 * (x * v_B[1] - y * v_B[0])
    return (
        v_B[0] + w * t0 + y * t2 - z * t1,
        v_B[1] + w * t1 + z * t0 - x * t2,
        v_B[2] + w * t2 + x * t1 - y * t0,
    )


@kernel
def rotation_matrix(q_NB: Quaternion) -> Matrix:
    """Return the rows of the matrix that takes components in B to N: for two vectors it is less work than `rotate`."""
    w, x, y, z = q_NB
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz, xy, xz, yz = x * x2, y * y2, z * z2, x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@kernel
def to_N(R_NB: Matrix, v_B: Vector) -> Vector:
    """Return the components in N of a vector given in B."""
    (a, b, c), (d, e, f), (g, h, i) = R_NB
    x, y, z = v_B
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


@kernel
def to_B(R_NB: Matrix, v_N: Vector) -> Vector:
    """Return the components in B of a vector given in N."""
    (a, b, c), (d, e, f), (g, h, i) = R_NB
    x, y, z = v_N
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


@kernel
def from_rotation_vector(v_B: Vector) -> Quaternion:
    """Return the quaternion of the rotation about `v_B` by its length [rad]."""
    angle = math.sqrt(v_B[0] * v_B[0] + v_B[1] * v_B[1] + v_B[2] * v_B[2])
    sine, cosine = sin_cos(0.5 * angle)
    scale = sine / angle if angle > 1e-12 else 0.5
    return cosine, scale * v_B[0], scale * v_B[1], scale * v_B[2]


@kernel
def to_euler(q_NB: Quaternion) -> Vector:
    """Return ZYX Euler angles phi, theta, psi [rad]; theta in [-pi/2, pi/2]."""
    sines, cosines = euler_sides(q_NB)
    return arctan2(sines[0], cosines[0]), arctan2(sines[1], cosines[1]), arctan2(sines[2], cosines[2])


@kernel
def euler_sides(q_NB: Quaternion) -> tuple[Vector, Vector]:
    """Return sines and cosines of the ZYX Euler angles, those of phi and psi times the cosine of theta."""
    w, x, y, z = q_NB
    sin_theta = min(max(2.0 * (w * y - z * x), -1.0), 1.0)
    sines = (2.0 * (w * x + y * z), sin_theta, 2.0 * (w * z + x * y))
    cos_theta = math.sqrt((1.0 - sin_theta) * (1.0 + sin_theta))
    return sines, (1.0 - 2.0 * (x * x + y * y), cos_theta, 1.0 - 2.0 * (y * y + z * z))


@kernel
def from_euler(phi: float, theta: float, psi: float) -> Quaternion:
    """Return the quaternion of ZYX Euler angles [rad]."""
    s1, c1 = sin_cos(0.5 * phi)
    s2, c2 = sin_cos(0.5 * theta)
    s3, c3 = sin_cos(0.5 * psi)
    return (
        c1 * c2 * c3 + s1 * s2 * s3,
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
    )


def rotate_rows(q_NB: NDArray[np.float64], v_B: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vectors `v_B` (n, 3) in N, by the attitudes (n, 4)."""
    w, axis = q_NB[:, :1], q_NB[:, 1:]
    twice = 2.0 * np.cross(axis, v_B)
    return np.asarray(v_B + w * twice + np.cross(axis, twice))


def euler_angles(q_NB: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ZYX Euler angles (n, 3) [rad] of quaternions (n, 4), with yaw unwrapped."""
    angles = wrapped_euler_angles(q_NB)
    angles[:, 2] = np.unwrap(angles[:, 2])
    return angles


def wrapped_euler_angles(q_NB: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ZYX Euler angles (n, 3) [rad] of quaternions (n, 4), each within half a turn."""
    w, x, y, z = q_NB.T
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    phi = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    psi = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([phi, theta, psi])
