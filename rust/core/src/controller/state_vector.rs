//! A controller's state as a row of numbers: the format of a batch for each of its arms.

use crate::controller::state::Memory;
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Length of the row of an arm of `n` joints.
pub(crate) const fn width(n: usize) -> usize {
    2 + 7 * n + 3 * MAX_AXES + 2 * POSE + MAX_AXES + 2
}

/// Rotation matrix and position.
const POSE: usize = 12;

/// Status flags; their sum is element 0 of the row. 0: not started, the positions of the next step become the reset
/// positions.
#[derive(Clone, Copy)]
enum Flag {
    Started = 1,
    Cold = 2,
    Limited = 4,
    /// Reset to the stored goals before the next step.
    Waiting = 8,
}

/// Status of an arm whose state is in a row.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Kept<'a> {
    /// Not started.
    New,
    /// Reset to these positions before the next step.
    Waiting(&'a [f64]),
    /// At least one step has run.
    Running,
}

/// Visits all fields of the state except the flags, slice by slice, in the same order for writing and reading.
#[inline(always)]
fn walk(memory: &mut Memory, limit: &mut JointVec, n: usize, mut visit: impl FnMut(&mut [f64])) {
    // Exhaustive destructuring: a new field must be stored too.
    let Memory { filter, gamma, goal, weight, singular, governor, rest, integral, started: _, cold: _, limit: _ } =
        memory;
    visit(&mut goal[..n]);
    visit(std::slice::from_mut(gamma));
    for joints in [&mut filter.held, &mut filter.velocity, weight, limit, rest, integral] {
        visit(&mut joints[..n]);
    }
    let [weak, second] = &mut singular.weak;
    for vector in [weak, second, &mut singular.strong, &mut governor.velocity] {
        visit(vector);
    }
    for pose in [&mut governor.pose, &mut governor.target] {
        visit(pose.rotation.as_flattened_mut());
        visit(&mut pose.position);
    }
    visit(&mut governor.target_speed);
}

impl Memory {
    /// Writes the state into `row`, which is [`width`] long.
    pub(crate) fn keep(&mut self, n: usize, row: &mut [f64]) {
        let (mut limit, n) = (self.limit.unwrap_or([0.0; MAX_JOINTS]), n.min(MAX_JOINTS));
        let all = [(self.started, Flag::Started), (self.cold, Flag::Cold), (self.limit.is_some(), Flag::Limited)];
        let flags = all.iter().fold(0_u32, |sum, &(on, flag)| if on { sum + flag as u32 } else { sum });
        let Some((first, mut rest)) = row.split_first_mut() else { return };
        *first = f64::from(flags);
        walk(self, &mut limit, n, |numbers| {
            let slots;
            let size = numbers.len().min(rest.len());
            (slots, rest) = std::mem::take(&mut rest).split_at_mut(size);
            slots.copy_from_slice(&numbers[..slots.len()]);
        });
    }

    /// Reads the state from `row`, whose status is [`Kept::Running`].
    pub(crate) fn recall(&mut self, n: usize, row: &[f64]) {
        let (Some((&flags, mut rest)), n) = (row.split_first(), n.min(MAX_JOINTS)) else { return };
        let mut limit = [0.0; MAX_JOINTS];
        walk(self, &mut limit, n, |numbers| {
            let slots;
            (slots, rest) = rest.split_at(numbers.len().min(rest.len()));
            numbers[..slots.len()].copy_from_slice(slots);
        });
        self.started = true;
        self.cold = Flag::Cold.is_in(flags);
        self.limit = Flag::Limited.is_in(flags).then_some(limit);
    }
}

impl Flag {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sum of flags")]
    fn is_in(self, flags: f64) -> bool {
        (flags as u32) & self as u32 != 0
    }
}

impl<'a> Kept<'a> {
    /// Returns the status of a row of an arm of `n` joints.
    pub(crate) fn of(row: &'a [f64], n: usize) -> Self {
        match row.split_first() {
            Some((&flags, rest)) if Flag::Waiting.is_in(flags) => Self::Waiting(&rest[..n.min(rest.len())]),
            Some((&flags, _)) if Flag::Started.is_in(flags) => Self::Running,
            _ => Self::New,
        }
    }

    /// Resets `row`: to `q`, or to the positions of its next step.
    pub(crate) fn renew(row: &mut [f64], q: Option<&[f64]>) {
        row.fill(0.0);
        if let (Some(q), Some((first, rest))) = (q, row.split_first_mut()) {
            *first = f64::from(Flag::Waiting as u32);
            rest.iter_mut().zip(q).for_each(|(slot, value)| *slot = *value);
        }
    }
}
