//! Near a position limit the posture task fades while a push displaces the arm, so that the push need not overcome its
//! torque.

use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Law, NullSpace, PaperOptions};
use pliant_core::{Controller, Model, ModelOptions, Settings, StepInput};

use crate::seeded;

/// The grasp posture [rad]; clear of all position limits.
const Q: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
/// Another rest posture [rad]; clear of all position limits.
const OTHER_POSTURE: [f64; 7] = [0.2, -0.3, 0.4, -1.4, 0.6, 0.4, 0.1];

/// Displacement of the tool along y [m]; above twice the default `soft_until` it fully counts as a push.
const PUSH: f64 = 0.03;

fn arm() -> Arc<Model> {
    seeded::arm(0, &ModelOptions::default())
}

/// Creates a controller with a yielding y axis, and without speed limits of target and goals.
fn controller_with(mut settings: Settings) -> Controller {
    settings.tracking.goal_slew = f64::INFINITY;
    (settings.max_tool_speed, settings.max_tool_acceleration) = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
    settings.set_axes("y", Axis { yields: Some(CompliantSide::Both), ..Axis::default() }).unwrap();
    Controller::new(arm(), settings, Some(seeded::servos(0))).unwrap()
}

/// Creates a controller with this rest posture; `None`: the positions at reset.
fn controller_with_posture(law: Law, posture: Option<&[f64]>) -> Controller {
    controller_with(Settings {
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

/// Returns a controller with the rest posture `OTHER_POSTURE`, and one whose rest posture is that of each reset.
fn pair(law: Law) -> (Controller, Controller) {
    (controller_with_posture(law, Some(&OTHER_POSTURE)), controller_with_posture(law, None))
}

/// Returns the effect of the posture task at `q` with the tool displaced by `push` [m]: the largest difference in the
/// goals [rad] of both controllers.
fn posture_effect_under(push: f64, (one, other): &mut (Controller, Controller), q: &[f64]) -> f64 {
    goals(one, q, push).iter().zip(goals(other, q, push)).fold(0.0, |max, (a, b)| max.max((a - b).abs()))
}

/// Returns the effect of the posture task at `q` [rad] with the tool displaced by `PUSH`.
fn posture_effect(pair: &mut (Controller, Controller), q: &[f64]) -> f64 {
    posture_effect_under(PUSH, pair, q)
}

/// Returns the grasp posture with joint `i` at a distance of `room` [rad] from one of its limits.
fn near_limit(i: usize, upper: bool, room: f64) -> Vec<f64> {
    let (model, mut q) = (arm(), Q.to_vec());
    q[i] = if upper { model.upper()[i] - room } else { model.lower()[i] + room };
    q
}

#[test]
fn the_posture_has_no_effect_with_a_joint_at_its_limit() {
    for law in [Law::Cap, Law::Impedance] {
        let mut pair = pair(law);
        assert!(posture_effect(&mut pair, &Q) > 5e-4, "far from all limits, the posture has an effect");
        for (i, upper) in (0..7).flat_map(|i| [(i, false), (i, true)]) {
            let [at, clear] = [0.0, 0.1].map(|room| posture_effect(&mut pair, &near_limit(i, upper, room)));
            assert!(at < 1e-12 && clear > 1e-4, "{law:?}, joint {i}, upper {upper}: {at} {clear}");
        }
    }
    // Law `paper` does not fade the posture task at limits.
    assert!(posture_effect(&mut pair(Law::Paper), &near_limit(0, true, 0.0)) > 5e-4);
}

#[test]
fn the_posture_fades_linearly_near_a_limit() {
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
        controller_with(settings)
    };
    let (mut with_posture, mut without_posture) = (of(Some(posture.to_vec())), of(None));
    let mut at = |room: f64| {
        let q = near_limit(0, true, room);
        goals(&mut with_posture, &q, PUSH)
            .iter()
            .zip(goals(&mut without_posture, &q, PUSH))
            .fold(0.0_f64, |max, (a, b)| max.max((a - b).abs()))
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
fn a_rest_posture_at_a_limit_is_held() {
    let rest = near_limit(0, true, 0.0);
    let mut displaced = rest.clone();
    displaced[4] += 0.2;
    let pulled = posture_effect(
        &mut (controller_with_posture(Law::Cap, Some(&rest)), controller_with_posture(Law::Cap, None)),
        &displaced,
    );
    assert!(pulled > 1e-3, "{pulled}");
    assert!(posture_effect(&mut pair(Law::Cap), &displaced) < 1e-12, "another posture has no effect there");
}

#[test]
fn without_a_push_the_posture_moves_a_joint_off_its_limit() {
    for law in [Law::Cap, Law::Impedance] {
        let mut pair = pair(law);
        for i in 0..7 {
            let at = posture_effect_under(0.0, &mut pair, &near_limit(i, false, 0.0));
            assert!(at > 1e-4, "{law:?}, joint {i}: {at}");
        }
        // The posture task fades between a deviation of `soft_until` and twice that. Its torque is limited before the
        // fade, so the middle of the fade must be tested near its end.
        let q = near_limit(0, true, 0.0);
        let [none, half, whole] = [0.01, 0.0198, 0.02].map(|push| posture_effect_under(push, &mut pair, &q));
        assert!(none > 1e-4 && whole < 1e-12, "{law:?}: {none} {whole}");
        assert!(half < none && half > whole, "{law:?}: {none} {half} {whole}");
    }
}
