//! Near a position limit, the rest posture no longer acts on an arm that a push displaces: the push does not have to
//! overcome the null-space torque there.

use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Law, NullSpace, PaperOptions};
use pliant_core::{Controller, Model, ModelOptions, Settings, StepInput};

use crate::seeded;

/// The grasp posture [rad]; clear of all position limits.
const Q: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
/// Another rest posture [rad]; clear of all position limits.
const RATHER: [f64; 7] = [0.2, -0.3, 0.4, -1.4, 0.6, 0.4, 0.1];

/// Displacement of the tool along y [m], more than twice the default `soft_until`, so that it fully counts as a push.
const PUSH: f64 = 0.03;

fn arm() -> Arc<Model> {
    seeded::arm(0, &ModelOptions::default())
}

/// Creates a controller with a yielding y axis, and without speed limits of target and goals.
fn made(mut settings: Settings) -> Controller {
    settings.tracking.goal_slew = f64::INFINITY;
    (settings.max_tool_speed, settings.max_tool_acceleration) = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
    settings.set_axes("y", Axis { yields: Some(CompliantSide::Both), ..Axis::default() }).unwrap();
    Controller::new(arm(), settings, Some(seeded::servos(0))).unwrap()
}

/// Creates a controller with this rest posture; `None`: the positions at reset.
fn wants(law: Law, posture: Option<&[f64]>) -> Controller {
    made(Settings {
        law,
        null_space: NullSpace { posture: posture.map(<[f64]>::to_vec), ..NullSpace::default() },
        ..Settings::default()
    })
}

/// Returns the goals [rad] of the first step at `q`, with the tool displaced from its target along y by `push` [m].
fn goals(controller: &mut Controller, q: &[f64], push: f64) -> Vec<f64> {
    controller.reset(q).unwrap();
    let mut target = controller.model().forward_kinematics(q).unwrap();
    target.position[1] += push;
    controller.step(q, &target, &StepInput::default()).unwrap().goal().to_vec()
}

/// Returns a controller with the rest posture `RATHER`, and one that is at its rest posture everywhere.
fn pair(law: Law) -> (Controller, Controller) {
    (wants(law, Some(&RATHER)), wants(law, None))
}

/// Returns the largest difference in the goals [rad] of both controllers, the effect of the posture, at `q` with the
/// tool displaced by `push` [m].
fn say_under(push: f64, (one, other): &mut (Controller, Controller), q: &[f64]) -> f64 {
    goals(one, q, push).iter().zip(goals(other, q, push)).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// Returns the effect of the posture on the goals at `q` [rad] under the displacement `PUSH`.
fn say(pair: &mut (Controller, Controller), q: &[f64]) -> f64 {
    say_under(PUSH, pair, q)
}

/// Returns the grasp posture with joint `i` at a distance of `room` [rad] from one of its limits.
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
    // Law `paper` does not reduce the posture at limits.
    assert!(say(&mut pair(Law::Paper), &beside(0, true, 0.0)) > 5e-4);
}

#[test]
fn it_lets_go_evenly_from_a_twentieth_of_a_radian_on() {
    let mut posture = Q.map(|q| q + 0.01);
    posture[0] = 0.0;
    // Joint 0 itself has no weight in the posture cost: its distance from the posture changes in this test.
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
        // The posture fades between a deviation of `soft_until` and twice that; its torque limit acts before, so half
        // way it is below `none`.
        let q = beside(0, true, 0.0);
        let [none, half, whole] = [0.01, 0.0198, 0.02].map(|push| say_under(push, &mut pair, &q));
        assert!(none > 1e-4 && whole < 1e-12, "{law:?}: {none} {whole}");
        assert!(half < none && half > whole, "{law:?}: {none} {half} {whole}");
    }
}
