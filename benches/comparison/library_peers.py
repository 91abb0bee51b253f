"""Implementations in which a kinematics library computes pose and Jacobian, and NumPy the law."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from comparison import numpy_peer, problem
from comparison.numpy_peer import with_law
from comparison.peer import Implementation, Pair, loop
from comparison.problem import Array


def _peer(version: str, kinematics: Callable[[Array], Pair]) -> Implementation:
    step = with_law(problem.bench_arm(), kinematics)
    return Implementation(version, kinematics, step, loop(kinematics), batch_size=2_000)


def pinocchio() -> Implementation:
    """Return the Pinocchio implementation: one call computes tool frame and Jacobian."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(problem.URDF))
    data, frame, axes = model.createData(), model.getFrameId(problem.TOOL), pin.LOCAL_WORLD_ALIGNED

    def kinematics(q: Array) -> Pair:
        jacobian = pin.computeFrameJacobian(model, data, q, frame, axes)
        return data.oMf[frame].homogeneous, jacobian

    return _peer(f"Pinocchio {pin.__version__}", kinematics)


def mujoco() -> Implementation:
    """Return the MuJoCo implementation: it computes all body poses, then the tool's Jacobian."""
    import mujoco as mj

    compiler_options = (
        '<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco></robot>'
    )
    text = problem.URDF.read_text(encoding="utf-8").replace("</robot>", compiler_options)
    model = mj.MjModel.from_xml_string(text)
    data, body = mj.MjData(model), model.body(problem.TOOL).id
    jacobian, pose = np.empty((6, model.nv)), np.eye(4)
    linear, angular = jacobian[:3], jacobian[3:]
    position, rotation, qpos = data.xpos[body], data.xmat[body].reshape(3, 3), data.qpos

    def kinematics(q: Array) -> Pair:
        qpos[:] = q
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_jacBody(model, data, linear, angular, body)
        pose[:3, 3] = position
        pose[:3, :3] = rotation
        return pose, jacobian

    return _peer(f"MuJoCo {mj.__version__}", kinematics)


def dynibo() -> Implementation:
    """Return the Dynibo implementation (Rust).

    Dynibo returns the rotation as a quaternion and the Jacobian with angular rows first. The
    implementation converts both, which is part of the timed call.
    """
    import dynibo as library

    robot = library.Robot.from_urdf(str(problem.URDF))
    tool, n = robot.link_id(problem.TOOL), robot.joint_count
    flat, pose, jacobian = np.empty(6 * n), np.eye(4), np.empty((6, n))
    columns = flat.reshape(n, 6).T

    def kinematics(q: Array) -> Pair:
        robot.jacobian(q, tool, out=flat)
        found = robot.forward_kinematics(q, tool)
        x, y, z, w = found.rotation_xyzw
        pose[:3, 3] = found.translation
        pose[0, :3] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
        pose[1, :3] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
        pose[2, :3] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        jacobian[:3] = columns[3:]
        jacobian[3:] = columns[:3]
        return pose, jacobian

    return _peer(f"dynibo {library.__version__}", kinematics)


def optik() -> Implementation:
    """Return the optik implementation (Rust).

    Optik returns nested lists, and a Jacobian in tool axes. The implementation converts the lists
    to arrays and rotates the Jacobian to base axes, which is part of the timed call. If a URDF has
    two consecutive fixed joints, optik does not rotate the origin of the second one by the first;
    the variable `missing` corrects the resulting constant error of 4 mm.
    """
    from importlib.metadata import version

    import optik as library

    robot = library.Robot.from_urdf_file(str(problem.URDF), "base_link", problem.TOOL)
    q_zero = np.zeros(problem.bench_arm().n)
    missing = numpy_peer.kinematics_of(problem.bench_arm())(q_zero)[0] - np.array(robot.fk(q_zero))

    def kinematics(q: Array) -> Pair:
        pose, local = np.array(robot.fk(q)) + missing, np.array(robot.joint_jacobian(q))
        rotation = pose[:3, :3]
        return pose, np.concatenate((rotation @ local[:3], rotation @ local[3:]))

    return _peer(f"optik-py {version('optik-py')}", kinematics)


def placo() -> Implementation:
    """Return the placo implementation.

    It removes the Jacobian's columns for the floating base that placo adds to the arm.
    """
    from importlib.metadata import version

    import placo as library

    robot = library.RobotWrapper(str(problem.URDF), library.Flags.ignore_collisions)
    names = list(robot.joint_names())
    offset = robot.get_joint_offset(names[0])
    columns = slice(robot.get_joint_v_offset(names[0]), None)
    state = robot.state

    def kinematics(q: Array) -> Pair:
        state.q[offset:] = q
        robot.update_kinematics()
        jacobian = robot.frame_jacobian(problem.TOOL, "local_world_aligned")
        return robot.get_T_world_frame(problem.TOOL), jacobian[:, columns]

    return _peer(f"placo {version('placo')}", kinematics)
