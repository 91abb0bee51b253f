//! State of a controller between steps.

use crate::batch::state::{Flag, row_len};
use crate::kinematics::velocity_filter::VelocityFilter;
use crate::math::simd::{BaselineF64x8, JointVec16, JointVector, LANES};
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
    /// Part of the last goals that holds the arm against gravity [rad].
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

/// Number of values at the end of a row that do not belong to single joints.
const TAIL: usize = row_len(0) - 1;

/// Calls the macro `$joints` for each field with one number per joint, then `$numbers` for each other field as a slice,
/// in the order of the row, without the flags. `$get` returns the torque limits from the field `$limit`.
macro_rules! for_each_field {
    ($state:expr, $limit:ident => $get:expr; $joints:ident, $numbers:ident) => {
        // Destructured without `..`, so that a new field does not compile before it is stored.
        let State {
            filter: VelocityFilter { backlash_output, velocity },
            gamma,
            goal,
            gravity_offset,
            singular: SingularValues { min_vectors: [first, second], max_vector, smallest: _, largest: _ },
            governor: ReferenceGovernor { pose, velocity: reference_velocity, target, target_speed },
            rest,
            integral,
            started: _,
            cold: _,
            limit: $limit,
        } = $state;
        $joints!(0, goal);
        $joints!(1, backlash_output);
        $joints!(2, velocity);
        $joints!(3, gravity_offset);
        $joints!(4, $get);
        $joints!(5, rest);
        $joints!(6, integral);
        $numbers!(std::slice::from_mut(gamma));
        $numbers!(first.as_mut_slice());
        $numbers!(second.as_mut_slice());
        $numbers!(max_vector.as_mut_slice());
        $numbers!(reference_velocity.as_mut_slice());
        $numbers!(pose.rotation.as_flattened_mut());
        $numbers!(pose.position.as_mut_slice());
        $numbers!(target.rotation.as_flattened_mut());
        $numbers!(target.position.as_mut_slice());
        $numbers!(target_speed.as_mut_slice());
    };
}

/// Copy of the state of an arm of `n` joints into a row of numbers.
struct Write<'a> {
    state: &'a mut State,
    n: usize,
    row: &'a mut [f64],
}

/// Copy of a row of numbers into the state of an arm of `n` joints.
struct Read<'a> {
    state: &'a mut State,
    n: usize,
    row: &'a [f64],
}

impl Write<'_> {
    /// Writes a state with more than [`LANES`] joints; compiled once for all instruction sets.
    #[inline(never)]
    fn write_large(self) {
        self.write::<MAX_JOINTS>();
    }

    /// Writes a state with at most `N` joints. Writes `N` numbers for each field, because copies of a constant length
    /// are faster; the next field overwrites those after the last joint.
    #[inline(always)]
    fn write<const N: usize>(self) {
        let Self { state, n, row } = self;
        let Some((first, rest)) = row.split_first_mut() else { return };
        let cold = if state.cold { Flag::Cold as u32 } else { 0 };
        let limited = if state.limit.is_some() { Flag::Limited as u32 } else { 0 };
        *first = f64::from(u32::from(state.started) * Flag::Started as u32 + cold + limited);
        let (mut none, mut at) = ([0.0; MAX_JOINTS], 0);
        macro_rules! write_joints {
            ($index:literal, $field:expr) => {
                if let (Some(slots), Some(field)) = (rest[$index * n..].first_chunk_mut::<N>(), $field.first_chunk()) {
                    *slots = *field;
                }
            };
        }
        macro_rules! write_numbers {
            ($field:expr) => {
                let field = $field;
                if let Some(tail) = rest.last_chunk_mut::<TAIL>() {
                    tail[at..at + field.len()].copy_from_slice(field);
                }
                at += field.len();
            };
        }
        for_each_field!(state, limit => limit.as_mut().unwrap_or(&mut none); write_joints, write_numbers);
        let _ = at;
    }
}

impl Read<'_> {
    /// Reads a state with more than [`LANES`] joints; compiled once for all instruction sets.
    #[inline(never)]
    fn read_large(self) {
        self.read::<JointVec16>();
    }

    /// Reads a state with as many joints as `J` has elements.
    #[inline(always)]
    fn read<J: JointVector>(self) {
        let Self { state, n, row } = self;
        let Some((&flags, rest)) = row.split_first() else { return };
        let Some(tail) = rest.last_chunk::<TAIL>() else { return };
        let mut at = 0;
        macro_rules! read_joints {
            ($index:literal, $field:expr) => {
                J::load_slice(&rest[$index * n..][..n]).store($field);
            };
        }
        macro_rules! read_numbers {
            ($field:expr) => {
                let field = $field;
                field.copy_from_slice(&tail[at..at + field.len()]);
                at += field.len();
            };
        }
        for_each_field!(&mut *state, limit => limit.get_or_insert([0.0; MAX_JOINTS]); read_joints, read_numbers);
        let _ = at;
        state.started = true;
        state.cold = Flag::Cold.is_in(flags);
        if !Flag::Limited.is_in(flags) {
            state.limit = None;
        }
    }
}

impl State {
    /// Writes the state of an arm of `n` joints into `row`, whose length is that of `row_len`.
    pub(crate) fn write_to(&mut self, n: usize, row: &mut [f64]) {
        let write = Write { state: self, n, row };
        if n <= LANES { write.write::<LANES>() } else { write.write_large() }
    }

    /// Reads the state of an arm of `n` joints from `row`, which [`State::write_to`] has written.
    pub(crate) fn read_from(&mut self, n: usize, row: &[f64]) {
        let read = Read { state: self, n, row };
        if n <= LANES { read.read::<BaselineF64x8>() } else { read.read_large() }
    }
}
