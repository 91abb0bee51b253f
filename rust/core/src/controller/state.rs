//! State of a controller between steps.

use crate::kinematics::velocity_filter::VelocityFilter;
use crate::math::singular_values::SingularValues;
use crate::pose::Pose;
use crate::task::reference_governor::Governor;
use crate::{JointVec, MAX_JOINTS};

/// State between steps; small enough to be copied, so that a failed step leaves it unchanged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Memory {
    /// True after the first reset or step.
    pub(crate) started: bool,
    pub(crate) filter: VelocityFilter,
    /// γ of the last step.
    pub(crate) gamma: f64,
    /// Last goals: start of the slew.
    pub(crate) goal: JointVec,
    /// Part of the goals that carries gravity [rad].
    pub(crate) weight: JointVec,
    /// Last limits; `None` before the first, which is not slewed.
    pub(crate) limit: Option<JointVec>,
    pub(crate) singular: SingularValues,
    /// True if the singular vectors must be computed from scratch.
    pub(crate) cold: bool,
    pub(crate) governor: Governor,
    /// q at reset: the default rest posture.
    pub(crate) rest: JointVec,
    /// Lead stored by the integrating goal [rad].
    pub(crate) integral: JointVec,
}

impl Memory {
    pub(crate) fn new() -> Self {
        Self::at(&[0.0; MAX_JOINTS], Pose::IDENTITY, false)
    }

    /// State at rest in `q`, with the tool pose `tool`.
    pub(crate) fn at(q: &JointVec, tool: Pose, started: bool) -> Self {
        Self {
            started,
            filter: VelocityFilter::new(q),
            gamma: 1.0,
            goal: *q,
            weight: [0.0; MAX_JOINTS],
            limit: None,
            singular: SingularValues::start(),
            cold: true,
            governor: Governor::new(tool),
            rest: *q,
            integral: [0.0; MAX_JOINTS],
        }
    }
}
