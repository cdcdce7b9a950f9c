"""How the camera moves: prediction by constant velocity or by visual odometry, and the step into the new camera."""

from __future__ import annotations

import math
from dataclasses import replace

import gtsam
import numpy as np

from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.vo_estimate import OdometryMotion
from fvslam_graph.slam.covariances import sparse_rows, symmetric, transformed
from fvslam_graph.slam.inverse_depth import Array, inverse_depth_seen_from, points_seen_from
from fvslam_graph.slam.state import FIXED, ODOMETRY, POSE, SCALE, VELOCITY, State

SCALE_WALK = 0.04  # of log scale


def predict_constant_velocity(
    state: State, seconds: float, settings: SlamSettings, noise_inflation: float = 1.0
) -> State:
    """The velocity of the next step: that of the last one, driven by white noise, `noise_inflation` times the usual.

    The variance grows with the time, so that it does not depend on the frame rate (Bar-Shalom, Li, Kirubarajan 2001,
    section 6.2.2: the noise has a power spectral density, in m^2/s^3 and rad^2/s^3).
    """
    densities = (noise_inflation * np.repeat([settings.angular_noise, settings.linear_noise], 3)) ** 2
    covariance = state.covariance.copy()
    covariance[VELOCITY, VELOCITY] += np.diag(densities * seconds)
    return replace(state, covariance=covariance)


def with_scale_walk(state: State, renewed: float) -> State:
    """The scale as it is handed on, from landmarks that go out of view to the share `renewed` that begins.

    It drifts, by SCALE_WALK for a map that is renewed as a whole. No image tells by how much: it is what depths err
    alike, on roads, or because something moves itself.
    """
    covariance = state.covariance.copy()
    covariance[SCALE, SCALE] += SCALE_WALK**2 * renewed
    return replace(state, covariance=covariance)


def predict_from_odometry(state: State, odometry: OdometryMotion, seconds: float) -> State:
    """The velocity of the next step: what visual odometry measured over it (Alcantarilla et al. 2010)."""
    P = state.covariance.copy()
    P[ODOMETRY] *= odometry.scale_kept
    P[:, ODOMETRY] *= odometry.scale_kept
    P[ODOMETRY, ODOMETRY] += odometry.scale_added
    odometry_scale = odometry.scale_kept * state.odometry_scale

    motion = odometry.longer(math.exp(odometry_scale))
    velocity = gtsam.Pose3.Logmap(motion.pose.mean) / seconds
    J_motion = gtsam.Pose3.LogmapDerivative(motion.pose.mean) / seconds
    # Odometry is metric but for its own scale: in units of the map, it is as uncertain as these.
    J_scales = np.column_stack([-velocity * (0, 0, 0, 1, 1, 1), J_motion @ motion.J_scale])
    P[VELOCITY] = J_scales @ P[[SCALE, ODOMETRY]]
    P[:, VELOCITY] = P[VELOCITY].T
    P_new = P[VELOCITY, [SCALE, ODOMETRY]] @ J_scales.T + J_motion @ motion.pose.covariance @ J_motion.T
    P[VELOCITY, VELOCITY] = symmetric(P_new)
    return replace(state, velocity=velocity, odometry_scale=odometry_scale, covariance=P)


def motion_from_velocity(velocity: Array, seconds: float) -> tuple[gtsam.Pose3, Array]:
    """prev_T_cur of a velocity (6,) over a time, and the Jacobian (6, 6) of its right perturbation by the velocity."""
    twist = velocity * seconds
    return gtsam.Pose3.Expmap(twist), gtsam.Pose3.ExpmapDerivative(twist) * seconds


def compose(state: State, seconds: float) -> State:
    """The state as seen from the camera after its step: pose, landmarks and all covariances move along."""
    prev_T_cur, J_velocity = motion_from_velocity(state.velocity, seconds)
    rotation, translation = prev_T_cur.rotation().matrix(), prev_T_cur.translation()
    anchors, *J_anchors = points_seen_from(state.anchors, rotation, translation)
    inverse_depth, *J_inverse_depth = inverse_depth_seen_from(state.inverse_depth, rotation)
    points, *J_points = points_seen_from(state.points, rotation, translation)

    fixed = np.arange(FIXED)[None]
    J_scale = np.concatenate([np.zeros(3), translation @ rotation])[:, None]
    change = [
        (np.hstack([prev_T_cur.inverse().AdjointMap(), J_scale, J_velocity])[None], fixed[:, : VELOCITY.stop]),
        (np.eye(FIXED)[None, SCALE:], fixed),
    ]
    for (J_motion, J_part), rows in zip((J_anchors, J_inverse_depth, J_points), state.parts, strict=True):
        columns = np.hstack([np.broadcast_to(fixed[:, VELOCITY], (len(rows), 6)), rows])
        change.append((np.concatenate([J_motion @ J_velocity, J_part], axis=2), columns))
    return replace(
        state,
        world_T_camera=state.world_T_camera.compose(prev_T_cur),
        anchors=anchors,
        inverse_depth=inverse_depth,
        points=points,
        covariance=transformed(state.covariance, sparse_rows(change, len(state.covariance))),
    )


def last_motion(state: State, seconds: float) -> GaussianPose:
    """prev_T_cur of the step that the state has made."""
    prev_T_cur, J_velocity = motion_from_velocity(state.velocity, seconds)
    J_scale = np.concatenate([np.zeros(3), prev_T_cur.rotation().unrotate(prev_T_cur.translation())])
    jacobian = np.column_stack([J_scale, J_velocity])
    scaled_velocity = state.covariance[SCALE : VELOCITY.stop, SCALE : VELOCITY.stop]
    return GaussianPose(prev_T_cur, symmetric(jacobian @ scaled_velocity @ jacobian.T))


def reanchored(state: State, pose: GaussianPose) -> State:
    """The camera at another pose world_T_camera: the map, expressed in the camera, is not touched.

    How the new pose's error relates to the map's is not known, so that the two are taken as independent.
    """
    P = state.covariance.copy()
    P[POSE], P[:, POSE] = 0.0, 0.0
    P[POSE, POSE] = pose.covariance
    return replace(state, world_T_camera=pose.mean, covariance=P)
