//! Capabilities of an arm under its settings, in one pose or on a path. These functions allocate memory and take much
//! longer than a control step.

mod axis_strength;
mod check;
mod display;
mod issues;
mod push_path;
mod report;
mod tracking;

pub use check::{FeasibilityReport, Issue, check_path, check_pose};
pub use push_path::JointStop;
pub use report::{AxisReport, PoseReport, report, report_at};
pub use tracking::raise_soft;
