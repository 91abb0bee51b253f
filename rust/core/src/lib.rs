//! Compliant task-space control for arms with back-drivable position servos. This crate is independent of Python.
//!
//! Each module imports only from the modules above it in this list:
//!
//! * [`error`]: the one error type;
//! * `math`: SIMD number types, linear algebra, rotations; independent of robots;
//! * [`pose`]: position and rotation of one frame in another;
//! * [`model`]: URDF text → immutable, validated robot;
//! * [`kinematics`]: joint positions → pose, Jacobian, gravity, mass matrix; inverse kinematics;
//! * [`params`]: settings, task axes and servos; resolved once into the constants that the modules below read;
//! * [`task`]: target and tool pose → deviation, compliance and strength of each task axis;
//! * `law`: deviation and strength → offsets of the joint goals, and forces along the task axes;
//! * `command`: offsets and forces → goals and torque limits for the servos;
//! * [`batch`]: inputs, outputs and states of many arms, and their distribution over the cores;
//! * [`controller`]: the control step, which runs task, law and command once per cycle;
//! * [`analysis`]: capabilities of an arm in a pose or on a path;
//! * [`contact`]: commands and positions → estimated contact wrench;
//! * [`arm`]: operation of an arm without the controller: descent, hand guiding, joint following, command limits;
//! * [`equations`]: the paper's equations for Jacobians from other libraries.
//!
//! ```
//! use std::sync::Arc;
//! use pliant_core::{Axis, Controller, Model, ModelOptions, Servos, Settings, StepInput};
//!
//! # fn main() -> pliant_core::Result<()> {
//! # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/arm7.urdf");
//! let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
//! let model = Arc::new(Model::from_urdf_file(path, &options)?);
//! let servos = Servos::new(vec![150.0], vec![10.7]); // k_p [N·m/rad] and usable torque [N·m] of every joint
//!
//! let mut settings = Settings::default();
//! settings.set_axes("y", Axis { soft: Some([4.0; 2]), adaptation: 0.9, ..Axis::default() })?; // [N]
//! let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos))?;
//!
//! let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]; // measured [rad]
//! let target = model.forward_kinematics(&q)?;
//! let command = controller.step(&q, &target, &StepInput::default())?;
//! assert_eq!(command.goal().len(), 7); // [rad]
//! assert!(command.torque_limit().iter().all(|limit| *limit <= 10.7)); // [N·m]
//! # Ok(())
//! # }
//! ```
//!
//! Conventions: SI units; 6-vectors linear first; quaternions `wxyz` or `xyzw`, as in the function's name; poses
//! `base_from_tool`; Jacobians are geometric, taken at the tool, in base axes unless stated otherwise; gravity torques
//! are those that *hold* the arm.
#![deny(unsafe_code)]

pub mod analysis;
pub mod arm;
pub mod batch;
mod command;
pub mod contact;
pub mod controller;
pub mod equations;
pub mod error;
pub mod kinematics;
mod law;
mod math;
pub mod model;
pub mod params;
pub mod pose;
pub mod task;

pub use batch::{BatchCommand, BatchInput, BatchState, OnInvalid, Targets};
pub use contact::{ContactEstimator, ContactInput, ContactOptions, WrenchEstimate};
// Public functions return matrices of nalgebra, so users need the same version of it.
pub use nalgebra;

pub use analysis::{AxisReport, FeasibilityReport, Issue, JointStop, PoseReport};
pub use arm::{CommandLimiter, HandGuiding, JointFollower, Lowering, PositionFilter, ThermalModel};
pub use controller::{Command, Controller, Diagnostics, Snapshot, StepInput};
pub use equations::{
    activation, adapt_target, compliance, damped_pseudo_inverse, holding_torque, joint_torque_limits,
    null_space_projector, pose_error, responsibility,
};
pub use error::{Error, Result};
pub use kinematics::{GroupMasses, IkOptions, IkResult, IkStatus, JointFrames, Reference};
pub use math::simd::SimdLevel;
pub use model::{Model, ModelOptions, Payload};
pub use params::{
    Axis, AxisImpedance, AxisStrength, Compensation, CompliantSide, Damping, DampingParams, Follow, Frame, Gain,
    GravityUse, Law, LimitRule, LimitType, NullSpace, OnDeviationLimit, PaperOptions, Profile, Projector, Servos,
    Settings, Task, TorqueLimits, Tracking,
};
pub use pose::Pose;

/// Maximum number of independent joints of a chain, and of joints between base and tip, mimic joints included.
///
/// Fixed, so that the control step keeps all its data on the stack.
pub const MAX_JOINTS: usize = 16;

/// Maximum number of task axes: three translations and three rotations.
pub const MAX_AXES: usize = 6;

/// One number per independent joint, base to tip; the chain uses the first `n` entries.
pub type JointVec = [f64; MAX_JOINTS];

/// One number per task axis; a task with k axes uses the first k entries.
pub type AxisVec = [f64; MAX_AXES];

/// Up to six rows over the independent joints, e.g. of a Jacobian; columns beyond the chain's `n` are 0.
pub type Rows = [[f64; MAX_JOINTS]; MAX_AXES];
