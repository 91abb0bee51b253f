//! Batch steps with arbitrary numbers: each row equals the step of a separate controller, and an error changes no
//! state.

use pliant_core::{
    BatchCommand, BatchInput, BatchState, Command, Controller, Error, OnInvalid, Pose, SimdLevel, StepInput, Targets,
};

use super::arms::{Arm, CONTROLLERS, controller};
use super::checks::{assert_explained, ceiling};
use super::input::Input;
use super::step::pose;

/// Maximum number of steps in one run.
const STEPS: usize = 3;

struct Rows {
    q: Vec<f64>,
    poses: Vec<Pose>,
    dq: Option<Vec<f64>>,
    dt: Option<f64>,
}

impl Rows {
    fn read(input: &mut Input, arm: &Arm, count: usize) -> Self {
        let n = arm.model.n();
        let mut q: Vec<f64> = (0..count * n).map(|at| arm.q[at % n] + 1e-3 * (at / n) as f64).collect();
        let mut poses = vec![arm.target; count];
        let mut dq = input.option(|_| vec![0.1; count * n]);
        for _ in 0..input.below(8) {
            let row = input.below(count);
            match input.below(4) {
                0 => poses[row] = pose(input, &arm.target),
                1 if dq.is_some() => {
                    let at = row * n + input.below(n);
                    dq.iter_mut().for_each(|dq| dq[at] = input.number(0.1));
                }
                _ => {
                    let at = row * n + input.below(n);
                    q[at] = input.number(q[at]);
                }
            }
        }
        Self { q, poses, dq, dt: input.option(|input| input.number(0.01)) }
    }

    fn single(&self, n: usize, row: usize) -> (&[f64], &Pose, StepInput<'_>) {
        let dq = self.dq.as_ref().map(|dq| &dq[row * n..][..n]);
        (&self.q[row * n..][..n], &self.poses[row], StepInput { dt: self.dt, dq, ..StepInput::default() })
    }
}

struct Output([Vec<f64>; 3]);

impl Output {
    fn row(&self, n: usize, row: usize) -> [&[f64]; 3] {
        self.0.each_ref().map(|all| &all[row * n..][..n])
    }
}

/// Runs steps of a batch, with or without state, and compares them with single steps.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let (arm, initial) = controller(input.below(CONTROLLERS));
    let n = arm.model.n();
    let mut controller = initial.clone();
    controller.set_simd_level(input.pick(&SimdLevel::available()));
    // Mostly fewer arms than one chunk of 64; one count exceeds it.
    let count = 1 + input.pick(&[0, 1, 3, 7, 8, 11, 16, 64]);
    let invalid = input.pick(&[OnInvalid::Error, OnInvalid::Nan]);
    if input.flag() {
        let rows = Rows::read(&mut input, arm, count);
        return run_without_state(&controller, &rows, n, count, invalid);
    }
    let mut state = BatchState::new(n, count).unwrap();
    let mut singles: Vec<Controller> = vec![controller.clone(); count];
    for _ in 0..STEPS {
        let rows = Rows::read(&mut input, arm, count);
        if !run_with_state(&controller, &mut state, &mut singles, &rows, invalid) {
            return;
        }
    }
    run_with_damaged_state(&mut input, &controller, &state, arm, count);
}

fn step(
    controller: &Controller,
    rows: &Rows,
    count: usize,
    invalid: OnInvalid,
    state: Option<&mut BatchState>,
) -> Result<Output, Error> {
    let flat: Vec<f64> = rows.poses.iter().flat_map(|pose| pose.to_rows().into_iter().flatten()).collect();
    let size = count * controller.model().n();
    let mut out = Output([vec![-7.0; size], vec![-7.0; size], vec![-7.0; size]]);
    let [goal, torque_limit, velocity] = &mut out.0;
    let input =
        BatchInput { dt: rows.dt, dq: rows.dq.as_deref(), invalid, ..BatchInput::new(&rows.q, Targets::Poses(&flat)) };
    controller.step_batch(&input, state, BatchCommand { goal, torque_limit, velocity })?;
    Ok(out)
}

/// Panics unless the command of a row is NaN, as for an arm whose input is invalid.
fn assert_nan(row: [&[f64]; 3], error: &Error) {
    assert!(row.iter().all(|values| values.iter().all(|value| value.is_nan())), "{row:?} after {error}");
}

/// Panics unless the command of a row is bit-identical to that of a single step.
fn assert_same(row: usize, got: [&[f64]; 3], command: &Command) {
    let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    for (got, want) in got.into_iter().zip([command.goal(), command.torque_limit(), command.speed_limit()]) {
        assert_eq!(bits(got), bits(want), "row {row}: {got:?} {want:?}");
    }
}

/// Steps the batch and a separate controller per arm, and compares them. Returns false if the batch step failed after
/// it had stepped some arms.
fn run_with_state(
    controller: &Controller,
    state: &mut BatchState,
    singles: &mut [Controller],
    rows: &Rows,
    invalid: OnInvalid,
) -> bool {
    let (n, count, before) = (controller.model().n(), singles.len(), state.clone());
    let singles_before = singles.to_vec();
    let results: Vec<_> = singles
        .iter_mut()
        .enumerate()
        .map(|(row, single)| {
            let (q, target, input) = rows.single(n, row);
            single.step(q, target, &input).copied()
        })
        .collect();
    match step(controller, rows, count, invalid, Some(state)) {
        Ok(out) => {
            for (row, result) in results.iter().enumerate() {
                match result {
                    Ok(command) => assert_same(row, out.row(n, row), command),
                    Err(error) => {
                        assert_eq!(
                            invalid,
                            OnInvalid::Nan,
                            "batch accepts row {row}, its controller does not: {error}"
                        );
                        assert_nan(out.row(n, row), error);
                    }
                }
            }
            true
        }
        Err(error) => {
            assert_explained(&error);
            assert!(results.iter().any(Result::is_err), "every separate controller accepts its row: {error}");
            let late = error.to_string().contains("not finite: nothing was sent");
            assert!(late || bits_of(state) == bits_of(&before), "the state has changed after: {error}");
            singles.clone_from_slice(&singles_before);
            !late
        }
    }
}

fn bits_of(state: &BatchState) -> Vec<u64> {
    state.as_slice().iter().map(|value| value.to_bits()).collect()
}

fn run_without_state(controller: &Controller, rows: &Rows, n: usize, count: usize, invalid: OnInvalid) {
    // Without a state, goals and tool have no speed limit. Results equal those of a single step only if the settings
    // have no such limits either.
    let mut unlimited = controller.settings().clone();
    unlimited.tracking.goal_slew = f64::INFINITY;
    unlimited.max_tool_speed = [f64::INFINITY; 2];
    let comparable = unlimited == *controller.settings();
    let ceiling = ceiling(controller);
    match step(controller, rows, count, invalid, None) {
        Ok(out) => {
            for row in 0..count {
                let (q, target, input) = rows.single(n, row);
                let mut single = controller.clone();
                let [goal, limit, speed] = out.row(n, row);
                match single.step(q, target, &input) {
                    Ok(command) => {
                        let within = limit.iter().zip(&ceiling).all(|(limit, max)| (0.0..=*max).contains(limit));
                        assert!(goal.iter().all(|goal| goal.is_finite()) && within, "row {row}: {goal:?} {limit:?}");
                        if comparable {
                            assert_same(row, [goal, limit, speed], command);
                        }
                    }
                    Err(error) => {
                        assert_eq!(
                            invalid,
                            OnInvalid::Nan,
                            "batch accepts row {row}, its controller does not: {error}"
                        );
                        assert_nan([goal, limit, speed], &error);
                    }
                }
            }
        }
        Err(error) => assert_explained(&error),
    }
}

/// Continues from a state with arbitrary numbers, as from a damaged file.
fn run_with_damaged_state(input: &mut Input, controller: &Controller, state: &BatchState, arm: &Arm, count: usize) {
    let n = arm.model.n();
    let mut values = state.as_slice().to_vec();
    for _ in 0..input.below(6) {
        let row_len = values.len() / count;
        let at = input.below(count) * row_len + input.below(row_len);
        values[at] = input.number(values[at]);
    }
    let mut state = BatchState::from_vec(n, values).unwrap();
    let rows = Rows { q: arm.q.repeat(count), poses: vec![arm.target; count], dq: None, dt: None };
    let ceiling = ceiling(controller);
    match step(controller, &rows, count, OnInvalid::Nan, Some(&mut state)) {
        Ok(out) => {
            for row in 0..count {
                let [goal, limit, _] = out.row(n, row);
                let within = limit.iter().zip(&ceiling).all(|(limit, max)| (0.0..=*max).contains(limit));
                let sendable = goal.iter().all(|goal| goal.is_finite()) && within;
                assert!(sendable || goal.iter().all(|goal| goal.is_nan()), "row {row}: {goal:?} {limit:?}");
            }
        }
        Err(error) => assert_explained(&error),
    }
}
