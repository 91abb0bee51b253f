//! Control steps of many arms in one call, in chunks on all cores; one row of input, output and state per arm.

pub(crate) mod state;

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::MAX_AXES;
use crate::batch::state::{RowStatus, row_len};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::math::simd::{BaselineF64, BaselineF64x8, JointVector, LANES, flush_subnormals};
use crate::math::thread_pool::install;
use crate::model::Model;
use crate::params::{Params, RowAxes, Settings};
use crate::pose::Pose;

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

/// Input of one arm of a batch. Positions, target and velocity are unchecked: the step checks them.
#[derive(Clone, Copy)]
pub(crate) struct ArmInput<'a> {
    pub(crate) q: &'a [f64],
    pub(crate) target: Pose,
    pub(crate) dq: Option<&'a [f64]>,
    pub(crate) axes: RowAxes<'a>,
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
            let message = "this task has rotations, which positions do not determine: give poses";
            return Err(Error::config("targets", message));
        }
        Ok(count)
    }

    /// Checks the input and the state of every arm before any state changes; returns the error of the first invalid
    /// row.
    pub(crate) fn check_rows(&self, states: &[f64]) -> Result<()> {
        let (len, first) = (row_len(self.model.n()), FirstError::default());
        let check = |(index, states): (usize, &[f64])| {
            let start = index * CHUNK;
            let rows = start..start + states.len() / len;
            if !self.are_valid(rows.clone(), states) {
                for (row, state) in rows.zip(states.chunks_exact(len)) {
                    if let Err(error) = self.check_row(row, Some(state)) {
                        first.report(row, error);
                    }
                }
            }
        };
        if states.len() <= CHUNK * len {
            check((0, states));
        } else {
            install(|| states.par_chunks(CHUNK * len).enumerate().for_each(check))?;
        }
        first.result()
    }

    /// Returns true if [`Batch::check_row`] would accept the arms `rows` with these states; it may return false for
    /// valid rows, too.
    fn are_valid(&self, rows: Range<usize>, states: &[f64]) -> bool {
        let (n, input) = (self.model.n(), self.input);
        let has_more = input.dq.is_some() || input.caps.is_some() || input.adaptation.is_some();
        n <= LANES
            && rows.clone().all(|row| self.has_valid_pose(row))
            && states.chunks_exact(row_len(n)).all(|state| !matches!(RowStatus::of(state, n), RowStatus::Reset(_)))
            && !(has_more && rows.into_iter().any(|row| self.check_optional(row).is_err()))
    }

    /// Returns true if positions and target of arm `row` are valid; for arms of at most [`LANES`] joints. Compiled for
    /// the baseline instruction set only, because other sets gain little.
    #[inline(always)]
    fn has_valid_pose(&self, row: usize) -> bool {
        let n = self.model.n();
        let q = flush_subnormals(BaselineF64x8::load_slice(&self.input.q[row * n..][..n]));
        let target = self.target(row);
        let region = &self.params.target_region;
        self.params.is_plausible(q) && target.is_some_and(|target| !target.is_invalid::<BaselineF64>(region))
    }

    /// Checks the input of arm `row` and, if it has one, its state.
    fn check_row(&self, row: usize, state: Option<&[f64]>) -> Result<()> {
        let n = self.model.n();
        let q = &self.input.q[row * n..][..n];
        self.params.positions(self.model, "q", q).map_err(|error| error.in_row("Q", row))?;
        self.check_optional(row)?;
        self.check_row_target(row)?;
        match state.map(|state| RowStatus::of(state, n)) {
            Some(RowStatus::Reset(q)) => {
                let checked = self.params.positions(self.model, "q", q);
                checked.map(|_| ()).map_err(|error| error.in_row("state", row))
            }
            _ => Ok(()),
        }
    }

    /// Checks velocity, caps and adaptation of arm `row`, if it has them.
    fn check_optional(&self, row: usize) -> Result<()> {
        if let Some(dq) = self.dq(row) {
            self.model.joints_within("dq", dq, SPEED_BOUND).map_err(|error| error.in_row("dq", row))?;
        }
        self.params.check_row_axes(row, self.axes(row))
    }

    /// Returns the error of arm `row`, whose step has failed.
    #[cold]
    #[inline(never)]
    fn diagnose(&self, row: usize, state: Option<&[f64]>) -> Error {
        self.check_row(row, state).err().unwrap_or_else(|| Error::command_not_finite().in_row("Q", row))
    }

    /// Steps all arms. `make` creates the controller that a thread uses for its chunks. With it, `step` steps one arm
    /// from the row of its state, if there is one, and writes goal, torque limit and speed. It returns false if input,
    /// state or command are invalid; the command of the arm is then NaN. `is_checked` is true if [`Self::check_rows`]
    /// has found no error.
    pub(crate) fn run<A>(
        &self,
        is_checked: bool,
        state: Option<&mut [f64]>,
        out: BatchCommand<'_>,
        make: impl Fn() -> A + Sync + Send,
        step: impl Fn(&mut A, &ArmInput<'a>, Option<&mut [f64]>, [&mut [f64]; 3]) -> bool + Sync + Send,
    ) -> Result<()> {
        let (n, first) = (self.model.n(), FirstError::default());
        let BatchCommand { goal, torque_limit, velocity } = out;
        let chunk = |arm: &mut A, index: usize, mut states: Option<&mut [f64]>, outs: [&mut [f64]; 3]| {
            let [goals, limits, velocities] = outs;
            let outs = goals.chunks_exact_mut(n).zip(limits.chunks_exact_mut(n)).zip(velocities.chunks_exact_mut(n));
            for (i, ((goal, limit), velocity)) in outs.enumerate() {
                let row = index * CHUNK + i;
                let mut state = states.as_deref_mut().map(|states| &mut states[i * row_len(n)..][..row_len(n)]);
                let succeeded = self.arm(row, is_checked).is_some_and(|input| {
                    let outs = [&mut *goal, &mut *limit, &mut *velocity];
                    step(arm, &input, state.as_deref_mut(), outs)
                });
                if !succeeded {
                    for out in [goal, limit, velocity] {
                        out.fill(f64::NAN);
                    }
                    if self.input.invalid == OnInvalid::Error {
                        first.report(row, self.diagnose(row, state.as_deref()));
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
                outs.zip(states).for_each_init(&make, |arm, ((index, (a, b, c)), states)| {
                    chunk(arm, index, Some(states), [a, b, c]);
                });
            }
        })?;
        first.result()
    }

    /// Reads the input of arm `row`; `None` if its target is not the matrix of a pose or, unless it `is_checked`, its
    /// caps or adaptation are invalid.
    #[inline(always)]
    fn arm(&self, row: usize, is_checked: bool) -> Option<ArmInput<'a>> {
        let (n, axes) = (self.model.n(), self.axes(row));
        if !is_checked && self.params.check_row_axes(row, axes).is_err() {
            return None;
        }
        Some(ArmInput { q: &self.input.q[row * n..][..n], target: self.target(row)?, dq: self.dq(row), axes })
    }

    #[inline(always)]
    fn dq(&self, row: usize) -> Option<&'a [f64]> {
        let n = self.model.n();
        self.input.dq.map(|dq| &dq[row * n..][..n])
    }

    #[inline(always)]
    fn axes(&self, row: usize) -> RowAxes<'a> {
        let of_row = |values: &'a [f64]| &values[row * MAX_AXES..][..MAX_AXES];
        RowAxes { caps: self.input.caps.map(of_row), adaptation: self.input.adaptation.map(of_row) }
    }

    /// Returns the target of arm `row`, unchecked; `None` if the last row of its matrix is not that of a pose.
    #[inline(always)]
    fn target(&self, row: usize) -> Option<Pose> {
        match self.input.targets {
            Targets::One(pose) => Some(*pose),
            Targets::Poses(values) => match values[16 * row..].first_chunk() {
                Some(matrix) => Pose::from_unchecked_matrix(matrix),
                None => None,
            },
            Targets::Positions(values) => {
                let p = &values[3 * row..][..3];
                Some(Pose { position: [p[0], p[1], p[2]], ..Pose::IDENTITY })
            }
        }
    }

    /// Checks the target of arm `row`.
    fn check_row_target(&self, row: usize) -> Result<()> {
        let name = format!("targets[{row}]");
        match (self.input.targets, self.target(row)) {
            (Targets::Poses(_), Some(target)) => {
                target.check(&name)?;
                self.check_target(&name, &target)
            }
            (Targets::Poses(values), None) => {
                Err(Pose::no_homogeneous_matrix(&name, [12, 13, 14, 15].map(|i| values[16 * row + i])))
            }
            (Targets::Positions(_), Some(target)) => self.check_target(&name, &target),
            (Targets::One(_) | Targets::Positions(_), _) => Ok(()),
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
