//! Settings, task axes and servo parameters, and their conversion into the constants of one arm's control step.

mod axis;
mod axis_params;
mod axis_params_simd;
mod checks;
mod enum_names;
mod features;
mod groups;
mod impedance;
pub(crate) mod joint_space;
mod overspeed;
mod pacing;
mod presets;
mod resolved;
mod row_axes;
mod scales;
mod servos;
mod settings;
mod validate;

pub use axis::{AXIS_NAMES, Axis, CompliantSide, Frame, OnDeviationLimit, Profile, Task, parse_axes};
pub use axis_params::{AxisImpedance, AxisStrength};
pub(crate) use axis_params::{AxisParams, DeviationLimit, max_adaptation};
pub(crate) use axis_params_simd::AxisArray;
pub(crate) use features::Features;
pub use groups::{Compensation, NullSpace, PaperOptions, TorqueLimits, Tracking};
pub(crate) use overspeed::OverspeedParams;
pub use resolved::DampingParams;
pub(crate) use resolved::{NullSpaceCost, Params};
pub(crate) use row_axes::RowAxes;
pub(crate) use servos::{GravityOffset, ServoArrays};
pub use servos::{LimitType, Servos};
pub use settings::{Damping, Follow, Gain, GravityUse, Law, LimitRule, Projector, Settings};
