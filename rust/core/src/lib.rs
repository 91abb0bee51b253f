//! Compliant task-space control for arms with back-drivable position servos: the core, free of Python.
//!
//! Data moves one way, and a module imports only what stands above it:
//!
//! * [`error`], [`pose`]: what every floor shares;
//! * [`model`]: URDF text → immutable, validated robot;
//! * [`kinematics`]: joint positions → pose, Jacobian, gravity.
//!
//! Conventions: SI units; 6-vectors linear first; quaternions `xyzw`; poses `base_from_tool`; Jacobians are geometric,
//! taken at the tool, in base axes unless said otherwise; gravity torques are those that *hold* the arm.
#![deny(unsafe_code)]

mod command;
pub mod controller;
pub mod error;
pub mod functions;
pub mod kinematics;
pub mod law;
pub mod model;
mod plan;
pub mod pose;
mod pose_forms;
mod presets;
pub mod report;
pub mod servos;
pub mod settings;
mod survey;
pub mod task;

pub use controller::{Command, Controller, Record, StepInput};
pub use error::{Error, Result};
pub use functions::{
    activation, adapt_target, compliance, damped_pseudo_inverse, holding_torque, joint_torque_limits,
    null_space_projector, pose_error, responsibility,
};
pub use kinematics::{Frames, IkOptions, IkReason, IkSolution, Masses, Reference};
pub use model::{Model, ModelOptions, Payload};
pub use pose::Pose;
pub use report::{Check, Finding, Report};
pub use servos::{ServoKind, Servos};
pub use settings::Settings;

/// Most independent joints of a chain, and most joints between base and tip, mimic followers included.
///
/// The control step keeps everything on the stack; seven joints are usual, sixteen are room enough.
pub const MAX_JOINTS: usize = 16;

/// Most task axes: three translations and three rotations.
pub const MAX_AXES: usize = 6;

/// One number per independent joint, chain order; entries beyond the chain's `n` are 0.
pub type JointVec = [f64; MAX_JOINTS];

/// One number per task axis.
pub type AxisVec = [f64; MAX_AXES];

/// Up to six rows over the independent joints, e.g. a Jacobian; columns beyond the chain's `n` are 0.
pub type Rows = [[f64; MAX_JOINTS]; MAX_AXES];
