//! Steps of many arms at once, in chunks on all cores.

mod soa;
mod state;

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::controller::state::Memory;
use crate::controller::state_vector::{Kept, width};
use crate::controller::{Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::math::thread_pool::on_every_core;
use crate::pose::Pose;

use soa::Abreast;

pub use state::BatchState;

/// Arms per chunk, one bit each in a mask. A batch of this size runs on the caller's thread.
const PIECE: usize = 64;

/// Targets (`N`) of the arms.
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
pub enum Invalid {
    /// Step no arm; the error names the first such row.
    #[default]
    Refuse,
    /// Its command is NaN and its state is unchanged; the others are stepped.
    Nan,
}

/// Input of one step of `N` arms.
#[derive(Debug, Clone, Copy)]
pub struct BatchInput<'a> {
    /// Measured joint positions (`N` × n) [rad].
    pub q: &'a [f64],
    /// Targets.
    pub targets: Targets<'a>,
    /// Time since the last step [s]; `None`: 1 / rate.
    pub dt: Option<f64>,
    /// Joint velocities (`N` × n) [rad/s] in place of the filtered ones.
    pub dq: Option<&'a [f64]>,
    /// Handling of invalid rows.
    pub invalid: Invalid,
}

/// Output of `N` arms: as [`Command`](crate::Command), one row (n) per arm.
#[derive(Debug)]
pub struct BatchCommand<'a> {
    /// Goals of the position servos [rad].
    pub goal: &'a mut [f64],
    /// Torque limits [N·m].
    pub torque_limit: &'a mut [f64],
    /// Speeds for the servos' profile velocity registers [rad/s].
    pub velocity: &'a mut [f64],
}

impl Controller {
    /// Runs one control step of `N` arms; the controller's own state and record do not change.
    ///
    /// With a `state` each row is bit-identical to the result of a separate controller. Without `state` each row is the
    /// first step of a controller that was just reset to its q, with unbounded `goal_slew` and `max_tool_speed`. If the
    /// law is the published one (damping, projector and inverse of the paper) and the arm has at most seven joints,
    /// such steps are interleaved, one arm per SIMD lane. They equal single steps up to rounding, below 1e-11 of a
    /// row's largest number at λ ≥ 0.02.
    ///
    /// # Errors
    /// [`Error::Shape`] for inconsistent lengths; [`Error::Config`] for positions as targets of a task with rotations.
    /// With [`Invalid::Refuse`] the error of [`Controller::step`] for the first invalid row; `state` is then unchanged
    /// and `out` is undefined. A command that is not finite is found only during the step: the state of that arm is
    /// then unchanged, while other arms have been stepped.
    ///
    /// ```
    /// # use pliant_core::{BatchCommand, BatchInput, BatchState, Controller, Model, ModelOptions, Servos, Settings, Targets};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    /// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
    /// # let servos = Servos::new(vec![150.0], vec![10.7]);
    /// # let controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
    /// let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17].repeat(100); // [rad], row by row
    /// let target = model.forward_kinematics(&q[..7])?;
    /// let mut state = BatchState::new(7, 100)?;
    /// let (mut goal, mut torque_limit, mut velocity) = (q.clone(), q.clone(), q.clone());
    /// let out = BatchCommand { goal: &mut goal, torque_limit: &mut torque_limit, velocity: &mut velocity };
    /// controller.step_batch(&BatchInput::new(&q, Targets::One(&target)), Some(&mut state), out)?;
    /// assert!(torque_limit.iter().all(|limit| (0.0..=10.7).contains(limit))); // [N·m]
    /// # Ok(())
    /// # }
    /// ```
    pub fn step_batch(
        &self,
        input: &BatchInput<'_>,
        state: Option<&mut BatchState>,
        out: BatchCommand<'_>,
    ) -> Result<()> {
        let n = self.model().n();
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
        same("goal", out.goal.len(), n)?;
        same("torque_limit", out.torque_limit.len(), n)?;
        same("velocity", out.velocity.len(), n)?;
        if matches!(input.targets, Targets::Positions(_)) && self.settings().task.axes[3..].contains(&true) {
            let message = "positions alone say nothing of the rotations that this task has: give poses";
            return Err(Error::config("targets", message));
        }
        self.check_input(&StepInput { dt: input.dt, ..StepInput::default() })?;
        match state {
            None => {
                let mut free = self.clone();
                free.forget_bounds();
                free.rows(input, None, false, out)
            }
            Some(state) => {
                let changed = state.settings.as_deref().is_some_and(|before| before != self.settings());
                let rows = state.rows_of(self, count)?;
                if input.invalid == Invalid::Refuse {
                    self.check_rows(input, rows)?;
                }
                self.rows(input, Some(rows), changed, out)?;
                if changed || state.settings.is_none() {
                    state.settings = Some(Box::new(self.settings().clone()));
                }
                Ok(())
            }
        }
    }

    /// Checks all rows before anything is changed.
    fn check_rows(&self, input: &BatchInput<'_>, rows: &[f64]) -> Result<()> {
        let (n, first) = (self.model().n(), First::default());
        let check = |(index, rows): (usize, &[f64])| {
            for (i, kept) in rows.chunks_exact(width(n)).enumerate() {
                let row = index * PIECE + i;
                let fine = input.row(self, row).and_then(|_| match Kept::of(kept, n) {
                    Kept::Waiting(q) => self.positions("q", q).map(|_| ()).map_err(|error| error.in_row("state", row)),
                    Kept::New | Kept::Running => Ok(()),
                });
                if let Err(error) = fine {
                    first.report(row, error);
                }
            }
        };
        let pieces = rows.par_chunks(PIECE * width(n)).enumerate();
        if rows.len() <= PIECE * width(n) {
            check((0, rows));
        } else {
            on_every_core(|| pieces.for_each(check))?;
        }
        first.result()
    }

    /// Steps all arms.
    fn rows(
        &self,
        input: &BatchInput<'_>,
        state: Option<&mut [f64]>,
        changed: bool,
        out: BatchCommand<'_>,
    ) -> Result<()> {
        let (n, first) = (self.model().n(), First::default());
        let BatchCommand { goal, torque_limit, velocity } = out;
        let abreast = state.is_none() && self.goes_abreast();
        let step = |own: &mut Option<Self>, index: usize, mut kept: Option<&mut [f64]>, mut outs: [&mut [f64]; 3]| {
            let mut left = u64::MAX;
            if abreast {
                let outs = outs.each_mut().map(|out| &mut **out);
                left = self.instructions().run(Abreast { controller: self, input, first: index * PIECE, outs });
            }
            if left == 0 {
                return;
            }
            let controller = own.get_or_insert_with(|| self.settled());
            let [goals, limits, velocities] = outs;
            let outs = goals.chunks_exact_mut(n).zip(limits.chunks_exact_mut(n)).zip(velocities.chunks_exact_mut(n));
            for (i, ((goal, limit), velocity)) in outs.enumerate() {
                if left >> i & 1 == 0 {
                    continue;
                }
                let row = index * PIECE + i;
                let kept = kept.as_deref_mut().map(|rows| &mut rows[i * width(n)..][..width(n)]);
                match controller.row(input, row, kept, changed) {
                    Ok(()) => {
                        let command = &controller.command;
                        goal.copy_from_slice(command.goal());
                        limit.copy_from_slice(command.torque_limit());
                        velocity.copy_from_slice(command.speed_limit());
                    }
                    Err(error) => {
                        for out in [goal, limit, velocity] {
                            out.fill(f64::NAN);
                        }
                        if input.invalid == Invalid::Refuse {
                            first.report(row, error);
                        }
                    }
                }
            }
        };
        let outs = [goal, torque_limit, velocity];
        let size = PIECE * n;
        if input.q.len() <= size {
            step(&mut None, 0, state, outs);
            return first.result();
        }
        let outs = outs.map(|out| out.par_chunks_mut(size));
        let [goals, limits, velocities] = outs;
        let outs = (goals, limits, velocities).into_par_iter().enumerate();
        on_every_core(|| match state {
            None => outs.for_each_init(|| None, |own, (index, (a, b, c))| step(own, index, None, [a, b, c])),
            Some(state) => outs
                .zip(state.par_chunks_mut(PIECE * width(n)))
                .for_each_init(|| None, |own, ((index, (a, b, c)), kept)| step(own, index, Some(kept), [a, b, c])),
        })?;
        first.result()
    }

    /// Steps one arm; writes its state to `kept` only on success.
    fn row(&mut self, input: &BatchInput<'_>, row: usize, kept: Option<&mut [f64]>, changed: bool) -> Result<()> {
        let (n, one) = (self.model().n(), input.row(self, row)?);
        match kept.as_deref() {
            // The governor's start is irrelevant here: its speed is unbounded.
            None if self.plan.deviation_limits.is_empty() => self.memory = Memory::at(&one.q, one.target, true),
            None => self.memory = Memory::new(),
            Some(kept) => match Kept::of(kept, n) {
                Kept::New => self.memory = Memory::new(),
                Kept::Waiting(q) => self.reset(q).map_err(|error| error.in_row("state", row))?,
                Kept::Running => self.memory.recall(n, kept),
            },
        }
        if changed {
            self.adapt_memory();
        }
        self.advance(&one.q[..self.plan.n.min(crate::MAX_JOINTS)], &one.target, &one.input(input.dt))
            .map_err(|error| error.in_row("Q", row))?;
        if let Some(kept) = kept {
            self.memory.keep(n, kept);
        }
        Ok(())
    }
}

/// Input of one arm.
struct Row<'a> {
    q: crate::JointVec,
    target: Pose,
    dq: Option<&'a [f64]>,
}

impl Row<'_> {
    fn input(&self, dt: Option<f64>) -> StepInput<'_> {
        StepInput { dt, dq: self.dq, ..StepInput::default() }
    }
}

impl<'a> BatchInput<'a> {
    /// Creates the input from measured joint positions `q` (`N` × n, row by row) [rad] and targets, without optional
    /// values.
    ///
    /// The step checks the lengths.
    pub fn new(q: &'a [f64], targets: Targets<'a>) -> Self {
        Self { q, targets, dt: None, dq: None, invalid: Invalid::default() }
    }

    /// Reads and checks the input of arm `row`.
    fn row(&self, controller: &Controller, row: usize) -> Result<Row<'a>> {
        let n = controller.model().n();
        let q = controller.positions("q", &self.q[row * n..][..n]).map_err(|error| error.in_row("Q", row))?;
        let dq = self.dq.map(|dq| &dq[row * n..][..n]);
        if let Some(dq) = dq {
            controller.joints("dq", dq, SPEED_BOUND).map_err(|error| error.in_row("dq", row))?;
        }
        Ok(Row { q, target: self.target(controller, row)?, dq })
    }

    fn target(&self, controller: &Controller, row: usize) -> Result<Pose> {
        let named = |of: &dyn Fn(&str) -> Result<Pose>| of("").or_else(|_| of(&format!("targets[{row}]")));
        match self.targets {
            Targets::One(pose) => Ok(*pose),
            Targets::Poses(values) => {
                let m = &values[16 * row..][..16];
                let line = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2], m[4 * i + 3]];
                named(&|name| {
                    let pose = Pose::from_rows_of(name, &[line(0), line(1), line(2), line(3)])?;
                    controller.check_target(name, &pose).map(|()| pose)
                })
            }
            Targets::Positions(values) => {
                let p = &values[3 * row..][..3];
                let pose = Pose { position: [p[0], p[1], p[2]], ..Pose::IDENTITY };
                named(&|name| controller.check_target(name, &pose).map(|()| pose))
            }
        }
    }
}

/// Error of the first failed row, from any thread.
#[derive(Default)]
struct First(Mutex<Option<(usize, Error)>>);

impl First {
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
