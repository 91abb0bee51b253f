//! What a controller carries from one step to the next.

use crate::law::feedforward::VelocityFilter;
use crate::law::singular::SingularValues;
use crate::pose::Pose;
use crate::task::governor::Governor;
use crate::{JointVec, MAX_JOINTS};

/// State between steps; small enough to be copied, so that a step that fails leaves it untouched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Memory {
    /// Whether a reset or a step has happened.
    pub(crate) started: bool,
    pub(crate) filter: VelocityFilter,
    /// γ of the last step.
    pub(crate) gamma: f64,
    /// Last goals: start of the slew.
    pub(crate) goal: JointVec,
    /// What of them carries the weight [rad].
    pub(crate) weight: JointVec,
    /// Last limits; `None` before the first, which is not slewed.
    pub(crate) limit: Option<JointVec>,
    pub(crate) singular: SingularValues,
    /// Whether the singular vectors must be found anew.
    pub(crate) cold: bool,
    pub(crate) governor: Governor,
    /// q at reset.
    pub(crate) rest: JointVec,
    /// Lead that the integrating goal has stored [rad].
    pub(crate) integral: JointVec,
}

impl Memory {
    pub(crate) fn new() -> Self {
        Self::at(&[0.0; MAX_JOINTS], Pose::IDENTITY, false)
    }

    /// At rest in `q`, the tool in `tool`.
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
