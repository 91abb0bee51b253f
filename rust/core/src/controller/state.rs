//! State of a controller between steps.

use crate::batch::state::Flag;
use crate::kinematics::velocity_filter::VelocityFilter;
use crate::math::rows::pad;
use crate::math::singular_values::SingularValues;
use crate::pose::Pose;
use crate::task::reference_governor::ReferenceGovernor;
use crate::{JointVec, MAX_JOINTS};

/// State between steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    /// True after the first reset or step.
    pub(crate) started: bool,
    pub(crate) filter: VelocityFilter,
    /// Factor γ on feed-forward and prediction, of the last step.
    pub(crate) gamma: f64,
    /// Last goals, from which the next ones are slewed [rad].
    pub(crate) goal: JointVec,
    /// Part of the last goals that carries gravity [rad].
    pub(crate) gravity_offset: JointVec,
    /// Last torque limits, from which the next ones are slewed [N·m]; `None` before the first step.
    pub(crate) limit: Option<JointVec>,
    pub(crate) singular: SingularValues,
    /// True if the singular vectors must be computed from scratch.
    pub(crate) cold: bool,
    pub(crate) governor: ReferenceGovernor,
    /// Positions at the last reset, the default rest posture [rad].
    pub(crate) rest: JointVec,
    /// Lead stored by the integrating goal [rad].
    pub(crate) integral: JointVec,
}

impl State {
    pub(crate) fn new() -> Self {
        Self::at(&[0.0; MAX_JOINTS], Pose::IDENTITY, false)
    }

    /// Returns the state of an arm at rest in `q` (n) [rad], with the tool at `tool`.
    pub(crate) fn resting(q: &[f64], tool: Pose) -> Self {
        Self::at(&pad(q, 0.0), tool, true)
    }

    /// Returns the state of an arm at rest in `q` [rad], with the tool at `tool`.
    pub(crate) fn at(q: &JointVec, tool: Pose, started: bool) -> Self {
        Self {
            started,
            filter: VelocityFilter::new(q),
            gamma: 1.0,
            goal: *q,
            gravity_offset: [0.0; MAX_JOINTS],
            limit: None,
            singular: SingularValues::start(),
            cold: true,
            governor: ReferenceGovernor::new(tool),
            rest: *q,
            integral: [0.0; MAX_JOINTS],
        }
    }
}

/// Calls `visit` for all fields of the state except the flags, slice by slice, in the same order for writing and
/// reading.
#[inline(always)]
fn for_each_field(state: &mut State, limit: &mut JointVec, n: usize, mut visit: impl FnMut(&mut [f64])) {
    // Destructured without `..`, so that a new field that is not stored is a compile error.
    let State {
        filter,
        gamma,
        goal,
        gravity_offset,
        singular,
        governor,
        rest,
        integral,
        started: _,
        cold: _,
        limit: _,
    } = state;
    visit(&mut goal[..n]);
    visit(std::slice::from_mut(gamma));
    for joints in [&mut filter.backlash_output, &mut filter.velocity, gravity_offset, limit, rest, integral] {
        visit(&mut joints[..n]);
    }
    let [min_vectors, second] = &mut singular.min_vectors;
    for vector in [min_vectors, second, &mut singular.max_vector, &mut governor.velocity] {
        visit(vector);
    }
    for pose in [&mut governor.pose, &mut governor.target] {
        visit(pose.rotation.as_flattened_mut());
        visit(&mut pose.position);
    }
    visit(&mut governor.target_speed);
}

impl State {
    /// Writes the state of an arm of `n` joints into `row`, whose length is that of `row_len`.
    pub(crate) fn write_to(&mut self, n: usize, row: &mut [f64]) {
        let (mut limit, n) = (self.limit.unwrap_or([0.0; MAX_JOINTS]), n.min(MAX_JOINTS));
        let all = [(self.started, Flag::Started), (self.cold, Flag::Cold), (self.limit.is_some(), Flag::Limited)];
        let flags = all.iter().fold(0_u32, |sum, &(on, flag)| if on { sum + flag as u32 } else { sum });
        let Some((first, mut rest)) = row.split_first_mut() else { return };
        *first = f64::from(flags);
        for_each_field(self, &mut limit, n, |numbers| {
            let slots;
            let size = numbers.len().min(rest.len());
            (slots, rest) = std::mem::take(&mut rest).split_at_mut(size);
            slots.copy_from_slice(&numbers[..slots.len()]);
        });
    }

    /// Reads the state of an arm of `n` joints from `row`, which [`State::write_to`] has written.
    pub(crate) fn read_from(&mut self, n: usize, row: &[f64]) {
        let (Some((&flags, mut rest)), n) = (row.split_first(), n.min(MAX_JOINTS)) else { return };
        let mut limit = [0.0; MAX_JOINTS];
        for_each_field(self, &mut limit, n, |numbers| {
            let slots;
            (slots, rest) = rest.split_at(numbers.len().min(rest.len()));
            numbers[..slots.len()].copy_from_slice(slots);
        });
        self.started = true;
        self.cold = Flag::Cold.is_in(flags);
        self.limit = Flag::Limited.is_in(flags).then_some(limit);
    }
}
