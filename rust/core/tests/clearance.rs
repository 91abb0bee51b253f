//! The posture lets go of an arm that a push has led to a position limit: what the push meets there is not the posture.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test may fail loudly, its helpers too")]

use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Law, NullSpace, PaperOptions};
use pliant_core::{Controller, Model, ModelOptions, Settings, StepInput};

#[path = "common/seeded.rs"]
mod seeded;

/// The grasp pose, and a posture that the arm might rather have; both clear of every limit.
const Q: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
const RATHER: [f64; 7] = [0.2, -0.3, 0.4, -1.4, 0.6, 0.4, 0.1];

/// A push along y whose deviation [m] is twice `soft_until`, with room to spare.
const PUSH: f64 = 0.03;

fn arm() -> Arc<Model> {
    seeded::arm(0, &ModelOptions::default())
}

/// `settings` with a yielding y axis, and targets and goals that are there at once.
fn made(mut settings: Settings) -> Controller {
    settings.tracking.goal_slew = f64::INFINITY;
    (settings.max_tool_speed, settings.max_tool_acceleration) = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
    settings.set_axes("y", Axis { yields: Some(CompliantSide::Both), ..Axis::default() }).unwrap();
    Controller::new(arm(), settings, Some(seeded::servos(0))).unwrap()
}

/// A controller that wants a posture, or the one it is reset to.
fn wants(law: Law, posture: Option<&[f64]>) -> Controller {
    made(Settings {
        law,
        null_space: NullSpace { posture: posture.map(<[f64]>::to_vec), ..NullSpace::default() },
        ..Settings::default()
    })
}

/// Goals [rad] of the first step at `q`, the tool pushed away from its target along y by `push` [m].
fn goals(controller: &mut Controller, q: &[f64], push: f64) -> Vec<f64> {
    controller.reset(q).unwrap();
    let mut target = controller.model().forward_kinematics(q).unwrap();
    target.position[1] += push;
    controller.step(q, &target, &StepInput::default()).unwrap().goal().to_vec()
}

/// One that wants another posture, and one that is content with every one.
fn pair(law: Law) -> (Controller, Controller) {
    (wants(law, Some(&RATHER)), wants(law, None))
}

/// How much the posture has to say in the goals at `q` under a push of `push` [m] [rad].
fn say_under(push: f64, (one, other): &mut (Controller, Controller), q: &[f64]) -> f64 {
    goals(one, q, push).iter().zip(goals(other, q, push)).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// The same under a push that is felt.
fn say(pair: &mut (Controller, Controller), q: &[f64]) -> f64 {
    say_under(PUSH, pair, q)
}

/// The grasp pose with joint i as far as `room` from a limit.
fn beside(i: usize, upper: bool, room: f64) -> Vec<f64> {
    let (model, mut q) = (arm(), Q.to_vec());
    q[i] = if upper { model.upper()[i] - room } else { model.lower()[i] + room };
    q
}

#[test]
fn a_posture_has_no_say_with_a_joint_at_its_limit() {
    for law in [Law::Cap, Law::Impedance] {
        let mut pair = pair(law);
        assert!(say(&mut pair, &Q) > 5e-4, "clear of all limits it has");
        for (i, upper) in (0..7).flat_map(|i| [(i, false), (i, true)]) {
            let [at, clear] = [0.0, 0.1].map(|room| say(&mut pair, &beside(i, upper, room)));
            assert!(at < 1e-12 && clear > 1e-4, "{law:?}, joint {i}, upper {upper}: {at} {clear}");
        }
    }
    // The paper knows no such thing.
    assert!(say(&mut pair(Law::Paper), &beside(0, true, 0.0)) > 5e-4);
}

#[test]
fn it_lets_go_evenly_from_a_twentieth_of_a_radian_on() {
    let mut posture = Q.map(|q| q + 0.01);
    posture[0] = 0.0;
    // What joint 0 would rather do is left out: it is the one that comes nearer.
    let of = |posture: Option<Vec<f64>>| {
        let posture_weights = Some(vec![0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        let settings = Settings {
            null_space: NullSpace { posture, max_torque: Some(50.0), ..NullSpace::default() },
            paper_options: PaperOptions { posture_weights, ..PaperOptions::default() },
            ..Settings::default()
        };
        made(settings)
    };
    let (mut held, mut free) = (of(Some(posture.to_vec())), of(None));
    let mut at = |room: f64| {
        let q = beside(0, true, room);
        goals(&mut held, &q, PUSH)
            .iter()
            .zip(goals(&mut free, &q, PUSH))
            .fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()))
    };
    let whole = at(0.06);
    assert!(whole > 1e-3);
    for i in 0..=60 {
        let room = 1e-3 * f64::from(i);
        let share = (2.0 * room / 0.05 - 1.0).clamp(0.0, 1.0);
        assert!((at(room) - share * whole).abs() < 0.02 * whole, "{room} rad: {} of {whole}", at(room));
    }
}

#[test]
fn a_posture_that_stands_at_a_limit_itself_is_held() {
    let rest = beside(0, true, 0.0);
    let mut displaced = rest.clone();
    displaced[4] += 0.2;
    let pulled = say(&mut (wants(Law::Cap, Some(&rest)), wants(Law::Cap, None)), &displaced);
    assert!(pulled > 1e-3, "{pulled}");
    assert!(say(&mut pair(Law::Cap), &displaced) < 1e-12, "another one has no say there");
}

#[test]
fn without_a_push_it_leads_a_joint_away_from_its_limit() {
    for law in [Law::Cap, Law::Impedance] {
        let mut pair = pair(law);
        for i in 0..7 {
            let at = say_under(0.0, &mut pair, &beside(i, false, 0.0));
            assert!(at > 1e-4, "{law:?}, joint {i}: {at}");
        }
        // It fades between the deviation at which compliance begins to fall and twice that; its torque is bounded before.
        let q = beside(0, true, 0.0);
        let [none, half, whole] = [0.01, 0.0198, 0.02].map(|push| say_under(push, &mut pair, &q));
        assert!(none > 1e-4 && whole < 1e-12, "{law:?}: {none} {whole}");
        assert!(half < none && half > whole, "{law:?}: {none} {half} {whole}");
    }
}
