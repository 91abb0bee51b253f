//! Control steps of many arms at once, in chunks on all cores; one row of input, output and state per arm.

pub(crate) mod state;

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::batch::state::{RowStatus, row_len};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::math::simd::BaselineF64;
use crate::math::thread_pool::install;
use crate::model::Model;
use crate::params::{Params, RowAxes, Settings};
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

pub use state::BatchState;

/// Number of arms per chunk, the unit of work of a thread. A batch of at most one chunk runs on the caller's thread.
const CHUNK: usize = 64;

/// Targets of `N` arms.
#[derive(Debug, Clone, Copy)]
pub enum Targets<'a> {
    /// One target for all arms.
    One(&'a Pose),
    /// Homogeneous matrices (`N` × 4 × 4), row-major.
    Poses(&'a [f64]),
    /// Positions (`N` × 3) [m], for tasks without rotations.
    Positions(&'a [f64]),
}

/// Handling of an arm whose positions, target or velocity are invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnInvalid {
    /// Return the error of the first invalid row; the states of all arms stay unchanged.
    #[default]
    Error,
    /// Write NaN as the command of that arm and leave its state unchanged; step the other arms.
    Nan,
}

/// Input of one step of `N` arms.
#[derive(Debug, Clone, Copy)]
pub struct BatchInput<'a> {
    /// Measured joint positions (`N` × n) [rad].
    pub q: &'a [f64],
    /// Targets of the arms.
    pub targets: Targets<'a>,
    /// Time since the last step [s]; `None`: 1 / rate.
    pub dt: Option<f64>,
    /// Joint velocities (`N` × n) [rad/s]; `None`: filtered from the positions.
    pub dq: Option<&'a [f64]>,
    /// Force caps (`N` × 6) of the axes x, y, z, roll, pitch, yaw [N, N·m; N·m under law `paper`], valid at every
    /// deviation; NaN for axes that do not yield. `None`: the caps of the settings.
    pub caps: Option<&'a [f64]>,
    /// Adaptation η (`N` × 6) of the same axes; NaN for axes that do not yield. `None`: the values of the settings.
    pub adaptation: Option<&'a [f64]>,
    /// Handling of arms whose input is invalid.
    pub invalid: OnInvalid,
}

/// Output arrays (`N` × n) for the commands of `N` arms; quantities as in [`Command`](crate::Command).
#[derive(Debug)]
pub struct BatchCommand<'a> {
    /// Goals of the position servos [rad].
    pub goal: &'a mut [f64],
    /// Torque limits [N·m].
    pub torque_limit: &'a mut [f64],
    /// Speeds for the servos' profile velocity registers [rad/s].
    pub velocity: &'a mut [f64],
}

/// Input of a batch, with the model and the parameters that its arms share.
#[derive(Clone, Copy)]
pub(crate) struct Batch<'a> {
    pub(crate) input: &'a BatchInput<'a>,
    pub(crate) model: &'a Model,
    pub(crate) params: &'a Params,
    pub(crate) settings: &'a Settings,
}

/// Validated input of one arm of a batch.
pub(crate) struct ArmInput<'a> {
    /// Index of the arm in the batch.
    pub(crate) row: usize,
    q: JointVec,
    n: usize,
    pub(crate) target: Pose,
    pub(crate) dq: Option<&'a [f64]>,
    pub(crate) axes: RowAxes<'a>,
}

impl ArmInput<'_> {
    /// Returns the measured joint positions (n) [rad].
    pub(crate) fn q(&self) -> &[f64] {
        &self.q[..self.n.min(MAX_JOINTS)]
    }
}

impl<'a> BatchInput<'a> {
    /// Creates the input from measured joint positions `q` (`N` × n, row-major) [rad] and targets; optional values are
    /// `None`. The step checks the lengths.
    pub fn new(q: &'a [f64], targets: Targets<'a>) -> Self {
        Self { q, targets, dt: None, dq: None, caps: None, adaptation: None, invalid: OnInvalid::default() }
    }
}

impl<'a> Batch<'a> {
    /// Checks the lengths of inputs and outputs and the kind of the targets; returns the number of arms.
    pub(crate) fn check(&self, out: &BatchCommand<'_>) -> Result<usize> {
        let (n, input) = (self.model.n(), self.input);
        if !input.q.len().is_multiple_of(n) {
            return Err(Error::rows("Q", input.q.len(), n));
        }
        let count = input.q.len() / n;
        let same = |what: &str, got: usize, each: usize| {
            if got == count * each { Ok(()) } else { Err(Error::length(what, got, count * each)) }
        };
        match input.targets {
            Targets::One(pose) => self.check_target("targets", pose)?,
            Targets::Poses(values) => same("targets", values.len(), 16)?,
            Targets::Positions(values) => same("targets", values.len(), 3)?,
        }
        same("dq", input.dq.map_or(count * n, <[f64]>::len), n)?;
        same("caps", input.caps.map_or(count * MAX_AXES, <[f64]>::len), MAX_AXES)?;
        same("adaptation", input.adaptation.map_or(count * MAX_AXES, <[f64]>::len), MAX_AXES)?;
        same("goal", out.goal.len(), n)?;
        same("torque_limit", out.torque_limit.len(), n)?;
        same("velocity", out.velocity.len(), n)?;
        if matches!(input.targets, Targets::Positions(_)) && self.settings.task.axes[3..].contains(&true) {
            let message = "positions alone say nothing of the rotations that this task has: give poses";
            return Err(Error::config("targets", message));
        }
        Ok(count)
    }

    /// Checks the input and the state of every arm before any state changes; returns the error of the first invalid
    /// row.
    pub(crate) fn check_rows(&self, rows: &[f64]) -> Result<()> {
        let (n, first) = (self.model.n(), FirstError::default());
        let check = |(index, rows): (usize, &[f64])| {
            for (i, row_state) in rows.chunks_exact(row_len(n)).enumerate() {
                let row = index * CHUNK + i;
                let checked = self.arm(row, false).and_then(|_| match RowStatus::of(row_state, n) {
                    RowStatus::Reset(q) => self
                        .params
                        .positions(self.model, "q", q)
                        .map(|_| ())
                        .map_err(|error| error.in_row("state", row)),
                    RowStatus::New | RowStatus::Running => Ok(()),
                });
                if let Err(error) = checked {
                    first.report(row, error);
                }
            }
        };
        let chunks = rows.par_chunks(CHUNK * row_len(n)).enumerate();
        if rows.len() <= CHUNK * row_len(n) {
            check((0, rows));
        } else {
            install(|| chunks.for_each(check))?;
        }
        first.result()
    }

    /// Steps all arms. `make` creates the controller that a thread uses for its chunks. With it, `step` steps one arm
    /// from the row of its state and writes goal, torque limit and speed. If that fails, the command of the arm is NaN.
    /// `is_checked` is true if [`Self::check_rows`] has found no error.
    pub(crate) fn run<A>(
        &self,
        is_checked: bool,
        state: Option<&mut [f64]>,
        out: BatchCommand<'_>,
        make: impl Fn() -> A + Sync + Send,
        step: impl Fn(&mut A, &ArmInput<'a>, Option<&mut [f64]>, [&mut [f64]; 3]) -> Result<()> + Sync + Send,
    ) -> Result<()> {
        let (n, first) = (self.model.n(), FirstError::default());
        let BatchCommand { goal, torque_limit, velocity } = out;
        let chunk = |arm: &mut A, index: usize, mut row_state: Option<&mut [f64]>, outs: [&mut [f64]; 3]| {
            let [goals, limits, velocities] = outs;
            let outs = goals.chunks_exact_mut(n).zip(limits.chunks_exact_mut(n)).zip(velocities.chunks_exact_mut(n));
            for (i, ((goal, limit), velocity)) in outs.enumerate() {
                let row = index * CHUNK + i;
                let row_state = row_state.as_deref_mut().map(|rows| &mut rows[i * row_len(n)..][..row_len(n)]);
                let outs = [&mut *goal, &mut *limit, &mut *velocity];
                let input = self.arm(row, is_checked);
                if let Err(error) = input.and_then(|input| step(arm, &input, row_state, outs)) {
                    for out in [goal, limit, velocity] {
                        out.fill(f64::NAN);
                    }
                    if self.input.invalid == OnInvalid::Error {
                        first.report(row, error);
                    }
                }
            }
        };
        let size = CHUNK * n;
        if self.input.q.len() <= size {
            chunk(&mut make(), 0, state, [goal, torque_limit, velocity]);
            return first.result();
        }
        let outs = [goal, torque_limit, velocity].map(|out| out.par_chunks_mut(size));
        let [goals, limits, velocities] = outs;
        let outs = (goals, limits, velocities).into_par_iter().enumerate();
        install(|| match state {
            None => outs.for_each_init(&make, |arm, (index, (a, b, c))| chunk(arm, index, None, [a, b, c])),
            Some(state) => {
                let states = state.par_chunks_mut(CHUNK * row_len(n));
                outs.zip(states).for_each_init(&make, |arm, ((index, (a, b, c)), row_state)| {
                    chunk(arm, index, Some(row_state), [a, b, c]);
                });
            }
        })?;
        first.result()
    }

    /// Reads the input of arm `row`, and checks it unless it `is_checked`.
    fn arm(&self, row: usize, is_checked: bool) -> Result<ArmInput<'a>> {
        let (n, model) = (self.model.n(), self.model);
        let q = &self.input.q[row * n..][..n];
        // Checked in any case, because the check costs no more than reading.
        let q = self.params.positions(model, "q", q).map_err(|error| error.in_row("Q", row))?;
        let dq = self.input.dq.map(|dq| &dq[row * n..][..n]);
        let of_row = |values: &'a [f64]| &values[row * MAX_AXES..][..MAX_AXES];
        let axes = RowAxes { caps: self.input.caps.map(of_row), adaptation: self.input.adaptation.map(of_row) };
        if !is_checked {
            if let Some(dq) = dq {
                model.joints_within("dq", dq, SPEED_BOUND).map_err(|error| error.in_row("dq", row))?;
            }
            self.params.check_row_axes(row, axes)?;
        }
        Ok(ArmInput { row, q, n, target: self.target(row, is_checked)?, dq, axes })
    }

    fn target(&self, row: usize, is_checked: bool) -> Result<Pose> {
        let named = |of: &dyn Fn(&str) -> Result<Pose>| of("").or_else(|_| of(&format!("targets[{row}]")));
        match self.input.targets {
            Targets::One(pose) => Ok(*pose),
            Targets::Poses(values) => {
                let m = &values[16 * row..][..16];
                let line = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2], m[4 * i + 3]];
                named(&|name| {
                    let pose = Pose::from_unchecked_rows(name, &[line(0), line(1), line(2), line(3)])?;
                    if !is_checked && pose.is_invalid::<BaselineF64>(&self.params.target_region) {
                        pose.check(name)?;
                        self.check_target(name, &pose)?;
                    }
                    Ok(pose)
                })
            }
            Targets::Positions(values) => {
                let p = &values[3 * row..][..3];
                let pose = Pose { position: [p[0], p[1], p[2]], ..Pose::IDENTITY };
                if is_checked {
                    return Ok(pose);
                }
                named(&|name| self.check_target(name, &pose).map(|()| pose))
            }
        }
    }

    fn check_target(&self, what: &str, target: &Pose) -> Result<()> {
        self.model.check_target_in(what, target, &self.params.target_region)
    }
}

/// Error of the failed row with the lowest index, collected from all threads.
#[derive(Default)]
struct FirstError(Mutex<Option<(usize, Error)>>);

impl FirstError {
    fn report(&self, row: usize, error: Error) {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if slot.as_ref().is_none_or(|(other, _)| row < *other) {
            *slot = Some((row, error));
        }
    }

    fn result(self) -> Result<()> {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), |(_, error)| Err(error))
    }
}
