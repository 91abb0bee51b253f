//! Settings, task axes and servo parameters, and their resolution for one arm into the constants of the control step.

mod axis;
mod axis_params;
mod axis_params_simd;
mod checks;
mod enum_names;
mod groups;
mod impedance;
mod pacing;
mod presets;
mod resolved;
mod scales;
mod servos;
mod settings;
mod validate;
pub(crate) mod workspace;

pub use axis::{AXIS_NAMES, Axis, Frame, OnDeviationLimit, Profile, Task, Yields, parse_axes};
pub(crate) use axis_params::DeviationLimit;
pub(crate) use axis_params_simd::AxisLanes;
pub use groups::{Compensation, NullSpace, PaperOptions, TorqueLimits, Tracking};
pub(crate) use resolved::{DampingPlan, NullSpaceCost, Plan};
pub(crate) use servos::ServoArrays;
pub use servos::{LimitType, Servos};
pub use settings::{Damping, Follow, Gain, GravityUse, Law, LimitRule, Projector, Settings};
