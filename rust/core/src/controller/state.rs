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
    /// Goals of the last step [rad], from which the next goals move at a limited speed.
    pub(crate) goal: JointVec,
    /// Part of the last goals that carries gravity [rad].
    pub(crate) gravity_offset: JointVec,
    /// Torque limits of the last step [N·m], from which the next limits rise at a limited rate; `None` before the first
    /// step.
    pub(crate) limit: Option<JointVec>,
    pub(crate) singular: SingularValues,
    /// True if the singular vectors must be computed without those of a previous step.
    pub(crate) cold: bool,
    pub(crate) governor: ReferenceGovernor,
    /// Positions at the last reset, the default rest posture [rad].
    pub(crate) rest: JointVec,
    /// Lead that the integrator has stored [rad].
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

/// Evaluates `$body` for each field of the state except the flags, in the order of the row; `$numbers` is the field as
/// a slice, `$n` the number of joints. A macro, because a closure would copy slices whose length is known at run time
/// only.
macro_rules! for_each_field {
    ($state:expr, $limit:expr, $n:expr, $numbers:ident => $body:expr) => {{
        // Destructured without `..`, so that a new field does not compile before it is stored.
        let State {
            filter: VelocityFilter { backlash_output, velocity },
            gamma,
            goal,
            gravity_offset,
            singular: SingularValues { min_vectors: [first, second], max_vector, smallest: _, largest: _ },
            governor:
                ReferenceGovernor { pose, velocity: reference_velocity, target, target_speed },
            rest,
            integral,
            started: _,
            cold: _,
            limit: _,
        } = $state;
        for_each_field!(@slices $numbers, $body;
            &mut goal[..$n], std::slice::from_mut(gamma), &mut backlash_output[..$n], &mut velocity[..$n],
            &mut gravity_offset[..$n], &mut $limit[..$n], &mut rest[..$n], &mut integral[..$n],
            first.as_mut_slice(), second.as_mut_slice(), max_vector.as_mut_slice(),
            reference_velocity.as_mut_slice(), pose.rotation.as_flattened_mut(), pose.position.as_mut_slice(),
            target.rotation.as_flattened_mut(), target.position.as_mut_slice(), target_speed.as_mut_slice()
        )
    }};
    (@slices $numbers:ident, $body:expr; $($slice:expr),*) => {
        {$({
            let $numbers: &mut [f64] = $slice;
            $body
        })*}
    };
}

impl State {
    /// Writes the state of an arm of `n` joints into `row`, whose length is that of `row_len`.
    pub(crate) fn write_to(&mut self, n: usize, row: &mut [f64]) {
        let (mut limit, n) = (self.limit.unwrap_or([0.0; MAX_JOINTS]), n.min(MAX_JOINTS));
        let all = [(self.started, Flag::Started), (self.cold, Flag::Cold), (self.limit.is_some(), Flag::Limited)];
        let flags = all.iter().fold(0_u32, |sum, &(on, flag)| if on { sum + flag as u32 } else { sum });
        let Some((first, mut rest)) = row.split_first_mut() else { return };
        *first = f64::from(flags);
        for_each_field!(self, limit, n, numbers => {
            let Some((slots, after)) = rest.split_at_mut_checked(numbers.len()) else { return };
            slots.copy_from_slice(numbers);
            rest = after;
        });
        let _ = rest;
    }

    /// Reads the state of an arm of `n` joints from `row`, which [`State::write_to`] has written.
    pub(crate) fn read_from(&mut self, n: usize, row: &[f64]) {
        let (Some((&flags, mut rest)), n) = (row.split_first(), n.min(MAX_JOINTS)) else { return };
        let mut limit = [0.0; MAX_JOINTS];
        for_each_field!(&mut *self, limit, n, numbers => {
            let Some((slots, after)) = rest.split_at_checked(numbers.len()) else { return };
            numbers.copy_from_slice(slots);
            rest = after;
        });
        let _ = rest;
        self.started = true;
        self.cold = Flag::Cold.is_in(flags);
        self.limit = Flag::Limited.is_in(flags).then_some(limit);
    }
}
