//! Batch steps that process several arms in parallel SIMD lanes give the commands of single steps, up to rounding.

use std::sync::Arc;

use pliant_core::params::{Damping, Follow, Law, NullSpace, PaperOptions, Projector, Tracking};
use pliant_core::{BatchInput, Controller, Model, ModelOptions, OnInvalid, Settings, SimdLevel, StepInput};

use crate::cases;
use crate::many::{ARMS, Arms, Out, single};
use crate::seeded::{self, Random};

/// Settings of law `paper` as printed, for which batch steps process several arms at once.
fn printed(random: &mut Random, model: &Arc<Model>) -> Settings {
    let settings = cases::settings(random, model, Law::Paper);
    Settings {
        max_tool_speed: [f64::INFINITY; 2],
        tracking: Tracking {
            damping: Damping::Fixed(random.pick(&[0.02, 0.05, 0.3])),
            goal_slew: f64::INFINITY,
            ..settings.tracking
        },
        null_space: NullSpace { projector: Projector::Paper, ..settings.null_space },
        paper_options: PaperOptions {
            follow: Some(Follow::Hold),
            budget_on_goal: false, // Off: its switch at zero deviation would depend on rounding.
            direction_band: random.pick(&[None, Some(0.5)]),
            ..settings.paper_options
        },
        ..settings
    }
}

#[test]
fn arms_side_by_side_are_single_arms_up_to_rounding() {
    let mut random = Random::new(13);
    let (mut locked, mut rows) = (0, 0);
    for round in 0..70 {
        let model = seeded::arm(round % 3, &ModelOptions::default());
        let n = model.n();
        let servos = cases::servos(&mut random, &seeded::servos(round % 3), n);
        let settings = cases::tamed(&model, printed(&mut random, &model), Some(&servos));
        let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
        let mut arms = Arms::new(&mut random, &model, ARMS);
        // Invalid rows: a NaN position and a NaN target.
        let bad = random.below(ARMS);
        arms.q[n * bad] = f64::NAN;
        arms.flat[16 * (bad / 2) + random.below(12)] = f64::NAN;
        let input = BatchInput { invalid: OnInvalid::Nan, ..arms.input(None, round % 2 == 1) };
        for simd_level in SimdLevel::available() {
            controller.set_simd_level(simd_level);
            let mut out = Out::new(ARMS, n);
            controller.step_batch(&input, None, out.command()).unwrap();
            for row in 0..ARMS {
                if row == bad || row == bad / 2 {
                    assert!(out.0.iter().all(|all| all[row * n..][..n].iter().all(|value| value.is_nan())));
                    continue;
                }
                let (q, dq) = (&arms.q[row * n..][..n], &arms.dq[row * n..][..n]);
                let input = StepInput { dq: input.dq.map(|_| dq), ..StepInput::default() };
                let mut alone = controller.clone();
                let want = single(&mut alone, q, &arms.poses[row], &input);
                let near = out.is_near(row, n, &want);
                assert!(near, "arm {row}, {simd_level}, {:?}\n{:?}", controller.settings(), (q, &arms.poses[row]));
                (locked, rows) = (locked + usize::from(alone.diagnostics().locked.contains(&true)), rows + 1);
            }
        }
    }
    assert!(rows > 10_000 && locked > 500, "{rows} rows, {locked} of them with a locked joint");
}
