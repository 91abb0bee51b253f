//! Python binding of `pliant-core`: a function converts its arguments, calls the core once, and converts the result.
#![deny(unsafe_code)]
#![allow(clippy::empty_docs, reason = "the docstrings of internal classes stay in the stub")]

// Defines the macro `stub!`, which returns docstrings of `python/pliant/_core.pyi`; build.rs writes it.
include!(concat!(env!("OUT_DIR"), "/stub.rs"));

mod arguments;
mod arm_cycle;
mod arm_points;
mod batch;
mod bus_cycle;
mod bus_status;
mod command;
mod command_limiter;
mod contact;
mod controller;
mod diagnostics;
mod error;
mod exclusive_access;
mod extras;
mod fields;
mod functions;
mod groups;
mod hand_guiding;
mod in_use;
mod joint_follower;
mod joint_readings;
mod kinds;
mod kinematics;
mod lowering;
mod model;
mod ndarray;
mod options;
mod pickle;
mod port_state;
mod pose;
mod position_filter;
mod read;
mod report;
#[cfg(unix)]
mod serial;
mod servo_codec;
#[cfg(unix)]
mod servo_group;
mod servos;
mod settings;
mod solution;
mod state;
mod step_batch;
mod task;
mod thermal;
mod tree;
mod words;

/// The compiled part of `pliant`.
///
/// Requires the interpreter lock: arrays are read through their C structure, and the pool from which control steps take
/// their commands relies on reference counts.
#[pyo3::pymodule(gil_used = true)]
mod _core {
    use pyo3::exceptions::PyRuntimeWarning;
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::arm_cycle::ArmCycle;
    #[pymodule_export]
    use crate::arm_points::ArmPoints;
    #[pymodule_export]
    use crate::bus_cycle::BusCycle;
    #[pymodule_export]
    use crate::bus_status::BusStatus;
    #[pymodule_export]
    use crate::command::Command;
    #[pymodule_export]
    use crate::command_limiter::CommandLimiter;
    #[pymodule_export]
    use crate::contact::{ContactEstimator, WrenchEstimate, update_contacts};
    #[pymodule_export]
    use crate::controller::Controller;
    #[pymodule_export]
    use crate::diagnostics::Diagnostics;
    #[pymodule_export]
    use crate::exclusive_access::ExclusiveAccess;
    #[pymodule_export]
    use crate::functions::{
        activation, adapt_target, compliance, damped_pseudo_inverse, holding_torque, joint_torque_limits,
        null_space_projector, pose_error, responsibility,
    };
    #[pymodule_export]
    use crate::groups::{Compensation, NullSpace, PaperOptions, TorqueLimits, Tracking};
    #[pymodule_export]
    use crate::hand_guiding::HandGuidingLaw;
    #[pymodule_export]
    use crate::joint_follower::JointFollower;
    #[pymodule_export]
    use crate::joint_readings::JointReadings;
    #[pymodule_export]
    use crate::lowering::{Lowering, torque_margin};
    #[pymodule_export]
    use crate::model::Model;
    #[pymodule_export]
    use crate::options::Payload;
    #[pymodule_export]
    use crate::port_state::PortState;
    #[pymodule_export]
    use crate::pose::{Pose, as_pose};
    #[pymodule_export]
    use crate::position_filter::PositionFilter;
    #[pymodule_export]
    use crate::report::{AxisReport, FeasibilityReport, Issue, JointStop, PoseReport, check_path};
    #[cfg(unix)]
    #[pymodule_export]
    use crate::serial::SerialPort;
    #[pymodule_export]
    use crate::servo_codec::ServoCodec;
    #[cfg(unix)]
    #[pymodule_export]
    use crate::servo_group::ServoGroup;
    #[pymodule_export]
    use crate::servos::Servos;
    #[pymodule_export]
    use crate::settings::Settings;
    #[pymodule_export]
    use crate::solution::IkResult;
    #[pymodule_export]
    use crate::state::State;
    #[pymodule_export]
    use crate::step_batch::BatchState;
    #[pymodule_export]
    use crate::task::{Axis, Task};
    #[pymodule_export]
    use crate::thermal::ThermalModel;
    #[pymodule_export]
    use crate::tree::{Inertial, Joint, Link, Mimic};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let py = module.py();
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("SUPPORT", pliant_core::arm::SUPPORT)?;
        crate::ndarray::initialise(py)?;
        crate::error::register(module)?;
        crate::pickle::register(module)?;
        if cfg!(debug_assertions) {
            let category = py.get_type::<PyRuntimeWarning>();
            let text = c"pliant was built without optimisation: steps take a hundred times as long as they should";
            PyErr::warn(py, &category, text, 1)?;
        }
        Ok(())
    }
}
