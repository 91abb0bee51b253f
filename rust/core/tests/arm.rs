//! Points, descent, hand guiding, joint follower and thermal model of an arm: tests with a quasi-static arm and with invalid inputs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test may fail loudly, its helpers too")]

mod common;

use std::sync::Arc;

use common::arm7;
use pliant_core::arm::{
    DEFAULT_SPEED, HandGuidingOptions, JointFollowerOptions, LoweringPhase, LoweringStart, SwingResult, ThermalOptions,
};
use pliant_core::kinematics::{ArmPoints, Reference};
use pliant_core::{Command, HandGuiding, JointFollower, JointVec, Lowering, MAX_JOINTS, Model, Servos, ThermalModel};
use proptest::prelude::*;

const Q: [f64; 7] = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]; // [rad]
const DT: f64 = 0.01; // [s]
const KP: f64 = 150.0; // [N·m/rad]
const TORQUE: f64 = 10.7; // [N·m]

fn padded(values: &[f64]) -> JointVec {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

fn servos() -> Servos {
    Servos { friction: vec![0.1], armature: vec![0.01], ..Servos::new(vec![KP], vec![TORQUE]) }.for_joints(7).unwrap()
}

fn start(q: &[f64]) -> LoweringStart<'_> {
    LoweringStart { q, goal: None, torque_limit: None, rest_q: None, speed: DEFAULT_SPEED }
}

fn lowering(model: &Arc<Model>, servos: &Servos, start: &LoweringStart<'_>) -> Lowering {
    let points = Arc::new(ArmPoints::new(model, &servos.armature).unwrap());
    Lowering::new(Arc::clone(model), servos, points, start).unwrap()
}

/// Returns the positions at which servos of stiffness `kp` [N·m/rad] hold the arm with the goals `goal` [rad].
fn held(model: &Model, goal: &[f64], kp: f64, q: &[f64]) -> Vec<f64> {
    let mut q = q.to_vec();
    for _ in 0..20 {
        let gravity = model.gravity(&q).unwrap();
        for i in 0..7 {
            q[i] += 0.7 * (goal[i] - gravity[i] / kp - q[i]);
        }
    }
    q
}

#[test]
fn points_move_as_their_jacobians_say_and_the_tool_as_the_model_says() {
    let model = arm7();
    let points = ArmPoints::new(&model, &[0.01; 7]).unwrap();
    let here = points.evaluate(&padded(&Q));
    let (pose, jacobian) = model.kinematics(&Q, Reference::WorldAligned).unwrap();
    let (tool, rows) = (here.position().last().unwrap(), here.jacobian().last().unwrap());
    for row in 0..3 {
        assert!((tool[row] - pose.position[row]).abs() < 1e-12);
        for joint in 0..7 {
            assert!((rows[row][joint] - jacobian[(row, joint)]).abs() < 1e-12);
        }
    }
    for joint in 0..7 {
        let at = |step: f64| {
            let mut q = padded(&Q);
            q[joint] += step;
            points.evaluate(&q)
        };
        let (ahead, behind) = (at(1e-6), at(-1e-6));
        for (k, rows) in here.jacobian().iter().enumerate() {
            for row in 0..3 {
                let slope = (ahead.position()[k][row] - behind.position()[k][row]) / 2e-6;
                assert!((rows[row][joint] - slope).abs() < 1e-8, "point {k}, joint {joint}");
            }
        }
    }
}

#[test]
fn effective_mass_is_what_an_impulse_meets() {
    let points = ArmPoints::new(&arm7(), &[0.01; 7]).unwrap();
    let here = points.evaluate(&padded(&Q));
    let dq = padded(&[0.3, -0.8, 0.5, 0.2, -0.4, 0.9, 0.1]);
    let velocity = here.velocity(&dq);
    let mass = here.effective_mass(&velocity, 0.0);
    let inertia = nalgebra::DMatrix::from_fn(7, 7, |i, j| here.inertia()[i][j]).lu();
    for (k, rows) in here.jacobian().iter().enumerate() {
        let speed = velocity[k].iter().map(|v| v * v).sum::<f64>().sqrt();
        let row = nalgebra::DVector::from_fn(7, |i, _| {
            (0..3).map(|axis| velocity[k][axis] / speed * rows[axis][i]).sum::<f64>()
        });
        if speed > 1e-9 {
            let mobility = row.dot(&inertia.solve(&row).unwrap());
            assert!((mass[k] * mobility - 1.0).abs() < 1e-9, "point {k}");
        }
    }
    assert!(here.effective_mass(&here.velocity(&[0.0; MAX_JOINTS]), 0.0).iter().all(|mass| *mass == 0.0));
}

/// The servos are stiffer or softer than the servo table says; the descent relies on measured positions only.
#[test]
fn a_quasi_static_arm_comes_down_with_a_wrong_stiffness() {
    for factor in [0.6, 1.0, 2.0] {
        let (model, servos) = (Arc::new(arm7()), servos());
        let kp = factor * KP;
        let gravity = model.gravity(&Q).unwrap();
        let goal: Vec<f64> = Q.iter().zip(gravity.iter()).map(|(q, g)| q + g / kp).collect();
        let mut down = lowering(&model, &servos, &LoweringStart { goal: Some(&goal), ..start(&Q) });
        let height = |q: &[f64]| model.forward_kinematics(q).unwrap().position[2];
        let (mut q, mut lowest) = (Q.to_vec(), height(&Q));
        let began = lowest;
        let mut ticks = 0;
        while let Some(command) = down.step(&q, &[true; 7], DT, 0.0).unwrap() {
            q = held(&model, command.goal(), kp, &q);
            assert!(height(&q) < lowest + 0.005, "the tool rises: factor {factor}, tick {ticks}");
            lowest = lowest.min(height(&q));
            assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)));
            assert!(command.speed_limit().iter().all(|limit| limit.is_infinite()));
            ticks += 1;
            assert!(ticks < 7000, "no end: factor {factor}, phase {:?}", down.phase());
        }
        assert_eq!(down.phase(), LoweringPhase::Done);
        assert!(lowest < began - 0.1, "factor {factor}: {began} to {lowest} m");
    }
}

#[test]
fn without_positions_the_model_comes_down_and_joints_get_a_speed_limit() {
    let (model, servos) = (Arc::new(arm7()), servos());
    let mut down = lowering(&model, &servos, &start(&Q));
    let (mut ticks, mut goal) = (0, Vec::new());
    while let Some(command) = down.step(&[f64::NAN; 7], &[true; 7], DT, 0.0).unwrap() {
        assert_eq!(command.speed_limit().iter().all(|limit| limit.is_finite()), down.is_blind());
        goal = command.goal().to_vec();
        ticks += 1;
        assert!(ticks < 10_000, "no end");
    }
    assert!(down.is_blind() && ticks > 600, "{ticks} ticks");
    let height = |q: &[f64]| model.forward_kinematics(q).unwrap().position[2];
    assert!(height(&goal) < height(&Q) - 0.1);
}

#[test]
fn wrong_lengths_and_numbers_are_named() {
    let (model, servos) = (Arc::new(arm7()), servos());
    let points = Arc::new(ArmPoints::new(&model, &servos.armature).unwrap());
    let refused = |start: &LoweringStart<'_>| {
        Lowering::new(Arc::clone(&model), &servos, Arc::clone(&points), start).unwrap_err().to_string()
    };
    assert!(refused(&start(&Q[..6])).contains("q has shape (6,), expected (7,)"));
    assert!(refused(&LoweringStart { rest_q: Some(&[f64::NAN; 7]), ..start(&Q) }).contains("rest[0]"));
    assert!(refused(&LoweringStart { speed: 0.0, ..start(&Q) }).contains("speed"));
    let mut down = lowering(&model, &servos, &start(&Q));
    assert!(down.step(&Q, &[true; 6], DT, 0.0).unwrap_err().to_string().contains("ok has shape (6,)"));
    assert!(ArmPoints::new(&model, &[0.0; 3]).unwrap_err().to_string().contains("armature"));
}

fn guiding(model: &Arc<Model>, stiffness_error: f64) -> HandGuiding {
    let gravity = model.gravity(&Q).unwrap();
    let lead: Vec<f64> = gravity.iter().map(|torque| torque / KP).collect();
    let goal: Vec<f64> = Q.iter().zip(&lead).map(|(q, lead)| q + lead).collect();
    let swing = SwingResult { q: &Q, goal: &goal, swung: &[true; 7], lead: &lead, friction: &[1e-3; 7] };
    let options = HandGuidingOptions { stiffness_error, delay: 0.0, torque_share: 0.3, payload_moments: [0.0; 4] };
    HandGuiding::new(Arc::clone(model), &servos(), &[0.5; 7], &swing, options).unwrap()
}

/// A drive may report its own limit as larger than the usable torque, or a lost register as negative.
#[test]
fn a_descent_starts_within_the_usable_torque() {
    let (model, servos) = (Arc::new(arm7()), servos());
    let sent = [1e6, -3.0, 20.0, TORQUE, 5.0, 0.0, 1e6];
    let mut down = lowering(&model, &servos, &LoweringStart { torque_limit: Some(&sent), ..start(&Q) });
    for _ in 0..3 {
        // Without a new position the limits stay as they were sent.
        let command = down.step(&Q, &[false; 7], DT, 0.0).unwrap().unwrap();
        assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)), "{command:?}");
        assert!((command.torque_limit()[4] - 5.0).abs() < 1e-12);
    }
}

#[test]
fn options_of_hand_guiding_are_named() {
    let model = Arc::new(arm7());
    let swing = SwingResult { q: &Q, goal: &Q, swung: &[true; 7], lead: &[0.0; 7], friction: &[1e-3; 7] };
    let usual = HandGuidingOptions { stiffness_error: 2.0, delay: 0.0, torque_share: 0.3, payload_moments: [0.0; 4] };
    let refused = |options: HandGuidingOptions| {
        HandGuiding::new(Arc::clone(&model), &servos(), &[0.5; 7], &swing, options).unwrap_err().to_string()
    };
    for (options, said) in [
        (HandGuidingOptions { stiffness_error: 0.9, ..usual }, "stiffness_error = 0.9"),
        (HandGuidingOptions { delay: f64::NAN, ..usual }, "delay [s] = NaN"),
        (HandGuidingOptions { delay: 20.0, ..usual }, "delay [s] = 20 is outside [0, 0.5]"),
        (HandGuidingOptions { torque_share: -0.1, ..usual }, "torque_share = -0.1"),
        (HandGuidingOptions { payload_moments: [-1.0, 0.0, 0.0, 0.0], ..usual }, "payload_moments[0] [kg] = -1"),
        (HandGuidingOptions { payload_moments: [1.0, 0.0, f64::INFINITY, 0.0], ..usual }, "payload_moments[2]"),
    ] {
        assert!(refused(options).contains(said), "{}", refused(options));
    }
}

/// A clock that was set while the arm was guided gives any period.
#[test]
fn a_period_at_the_edge_of_the_number_range_moves_no_goal_far() {
    let mut guiding = guiding(&Arc::new(arm7()), 2.2);
    for dt in [0.01, f64::MAX, 1e300, 0.01] {
        let command = guiding.step(&Q.map(|q| q + 0.01), dt).unwrap();
        assert!(command.goal().iter().zip(Q).all(|(goal, q)| (goal - q).abs() < 0.5), "{command:?}");
    }
}

#[test]
fn a_swing_narrows_the_interval_of_the_stiffness() {
    let model = Arc::new(arm7());
    let guiding = guiding(&model, 2.2);
    let gravity = model.gravity(&Q).unwrap();
    let [low, high] = guiding.stiffness();
    for i in 0..7 {
        assert!(low[i] <= KP && KP <= high[i], "joint {i}: {} to {}", low[i], high[i]);
        // The stiffness becomes known within a few per cent only for a joint that carries a load.
        if gravity[i].abs() > 1.0 {
            assert!(high[i] / low[i] < 1.5, "joint {i}: {} to {}", low[i], high[i]);
        }
    }
}

#[test]
fn a_resting_arm_stays_and_a_led_arm_stays_where_it_is_left() {
    let model = Arc::new(arm7());
    let mut guiding = guiding(&model, 1.1);
    let mut goal = vec![0.0; 7];
    for _ in 0..100 {
        goal = guiding.step(&Q, DT).unwrap().goal().to_vec();
    }
    let held_at = held(&model, &goal, KP, &Q);
    assert!(held_at.iter().zip(&Q).all(|(a, b)| (a - b).abs() < 5e-3), "{held_at:?}");
    let mut q = Q;
    for tick in 0..200 {
        q[1] = Q[1] + 0.3 * f64::from(tick) / 200.0;
        guiding.step(&q, DT).unwrap();
    }
    for _ in 0..100 {
        goal = guiding.step(&q, DT).unwrap().goal().to_vec();
    }
    let left_at = held(&model, &goal, KP, &q);
    assert!(left_at.iter().zip(&q).all(|(a, b)| (a - b).abs() < 2e-2), "{left_at:?} {q:?}");
}

const FORCE: f64 = 5.0; // [N]

fn follower(model: &Arc<Model>, max_force: [f64; 3]) -> JointFollower {
    let options = JointFollowerOptions { max_force, max_tool_speed: 0.6, max_joint_speed: 4.0 };
    JointFollower::new(Arc::clone(model), &servos(), options).unwrap()
}

/// Returns the torques that bounded servos with this stiffness exert at q beyond those that carry the arm.
fn exerted(model: &Model, command: &Command, q: &[f64]) -> Vec<f64> {
    let gravity = model.gravity(q).unwrap();
    (0..q.len())
        .map(|i| {
            let limit = command.torque_limit()[i];
            (KP * (command.goal()[i] - q[i])).clamp(-limit, limit) - gravity[i]
        })
        .collect()
}

#[test]
fn a_follower_at_its_target_carries_the_arm_and_nothing_else() {
    let model = Arc::new(arm7());
    let mut follower = follower(&model, [FORCE; 3]);
    for _ in 0..10 {
        let command = follower.step(&Q, &Q, DT).unwrap();
        assert!(exerted(&model, &command, &Q).iter().all(|torque| torque.abs() < 1e-12));
    }
}

#[test]
fn a_blocked_follower_pushes_with_its_force_and_does_not_wind_up() {
    let model = Arc::new(arm7());
    let jacobian = model.jacobian(&Q, Reference::WorldAligned).unwrap();
    let friction = servos().for_joints(7).unwrap().friction;
    for axis in 0..3 {
        let mut max_force = [0.0; 3];
        max_force[axis] = FORCE;
        let mut follower = follower(&model, max_force);
        let target: Vec<f64> = (0..7).map(|i| Q[i] + 0.3 * jacobian[(axis, i)].signum()).collect();
        let mut command = follower.step(&Q, &target, DT).unwrap();
        for _ in 0..500 {
            command = follower.step(&Q, &target, DT).unwrap();
        }
        for (i, torque) in exerted(&model, &command, &Q).iter().enumerate() {
            let lever = jacobian[(axis, i)].abs().max(0.1 * jacobian[(axis + 3, i)].abs());
            let most = FORCE * lever + friction[i];
            assert!((torque.abs() - most).abs() < 1e-9, "axis {axis}, joint {i}: {torque} and {most}");
            assert!((command.goal()[i] - Q[i]).abs() < 0.2, "joint {i} wound up to {}", command.goal()[i]);
        }
        // The force vanishes within the time in which the reference returns.
        for _ in 0..20 {
            command = follower.step(&Q, &Q, DT).unwrap();
        }
        assert!(exerted(&model, &command, &Q).iter().all(|torque| torque.abs() < 0.1), "{command:?}");
    }
}

#[test]
fn a_follower_keeps_its_speed_limits_and_the_position_limits() {
    let model = Arc::new(arm7());
    let mut follower = follower(&model, [f64::INFINITY; 3]);
    let far: Vec<f64> = Q.iter().map(|q| q + 9.0).collect();
    let (mut q, mut fastest) = (Q.to_vec(), 0.0_f64);
    for _ in 0..2000 {
        let command = follower.step(&q, &far, DT).unwrap();
        let next = held(&model, command.goal(), KP, &q);
        let before = model.forward_kinematics(&q).unwrap().position;
        let after = model.forward_kinematics(&next).unwrap().position;
        let path: f64 = before.iter().zip(&after).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        fastest = fastest.max(path / DT);
        q = next;
    }
    // The feed-forward of damping adds to the goals while they accelerate.
    assert!(fastest > 0.3 && fastest < 0.8, "{fastest} m/s");
    assert!(q.iter().zip(model.upper()).all(|(q, upper)| *q < upper + 1e-2), "{q:?}");
}

#[test]
fn a_follower_refuses_what_it_cannot_follow() {
    let model = Arc::new(arm7());
    let mut follower = follower(&model, [FORCE; 3]);
    follower.reset(&Q).unwrap();
    let before = follower.clone().step(&Q, &Q, DT).unwrap();
    assert!(follower.step(&Q[..6], &Q, DT).unwrap_err().to_string().contains("q has shape (6,)"));
    assert!(follower.step(&Q, &[f64::NAN; 7], DT).unwrap_err().to_string().contains("q_target[0]"));
    assert!(follower.step(&Q, &Q, 0.0).unwrap_err().to_string().contains("dt"));
    assert!(follower.reset(&[f64::INFINITY; 7]).is_err());
    assert_eq!(follower.step(&Q, &Q, DT).unwrap(), before);
    let mut options = *follower.options();
    options.max_force[1] = -1.0;
    assert!(follower.set_options(options).unwrap_err().to_string().contains("max_force[1]"));
    options.max_force = [FORCE; 3];
    options.max_tool_speed = f64::NAN;
    assert!(follower.set_options(options).unwrap_err().to_string().contains("max_tool_speed"));
}

#[test]
fn heat_follows_the_torque_and_bounds_the_limits() {
    let options =
        ThermalOptions { continuous: 0.4, time_constant: 30.0, supply: Some(2.0), shutdown_temperature: 70.0 };
    let mut model = ThermalModel::new(options, &[10.0, 10.0], Some(&[2.0, 2.0])).unwrap();
    for _ in 0..500 {
        model.update(&[10.0, 4.0], 0.01);
    }
    assert!((model.heat()[0] - 1.0).abs() < 0.05); // 5.2 s
    model.update(&[0.0, 4.0], 1e6);
    let mut ceiling = [0.0; 2];
    model.torque_ceiling(&mut ceiling);
    assert!((ceiling[0] - 10.0).abs() < 1e-9 && (ceiling[1] - 4.0).abs() < 1e-9, "{ceiling:?}");
    model.set_temperature(0, 64.0);
    model.set_temperature(9, 64.0);
    model.torque_ceiling(&mut ceiling);
    assert!((ceiling[0] - 5.0).abs() < 1e-9);
    let mut limit = [10.0, 10.0];
    model.limit_current(&[10.0, -10.0], &[3.0, 1.0], &mut limit);
    assert!((0.2 * (limit[0] + limit[1]) - 2.0).abs() < 0.01 && limit[0] >= 3.0 && limit[1] >= 1.0, "{limit:?}");
    let mut small = [10.0, 10.0];
    model.limit_current(&[4.0, 4.0], &[0.0, 0.0], &mut small);
    assert_eq!(small.map(f64::to_bits), [10.0_f64; 2].map(f64::to_bits));
    assert!(ThermalModel::new(options, &[10.0], None).unwrap_err().to_string().contains("stall currents"));
    let hostile = ThermalOptions { continuous: f64::NAN, ..options };
    assert!(ThermalModel::new(hostile, &[10.0], None).unwrap_err().to_string().contains("continuous"));
}

/// A lost reading counts as the usable torque: it heats, and it never makes a limit NaN.
#[test]
fn torques_that_are_no_numbers_heat() {
    let options = ThermalOptions { continuous: 0.4, time_constant: 30.0, supply: None, shutdown_temperature: 70.0 };
    for (torque, dt, heats) in [
        (f64::NAN, 60.0, true),
        (f64::INFINITY, 60.0, true),
        (1e200, 60.0, true),
        (10.0, f64::NAN, false),
        (10.0, -1.0, false),
        (10.0, f64::INFINITY, true),
    ] {
        let mut model = ThermalModel::new(options, &[10.0], None).unwrap();
        model.update(&[torque], dt);
        model.update(&[0.0], 0.01);
        let mut ceiling = [0.0];
        model.torque_ceiling(&mut ceiling);
        let expected = if heats { 4.0 } else { 10.0 };
        assert!((ceiling[0] - expected).abs() < 1e-9, "{torque} for {dt} s: {ceiling:?}");
    }
    let slow = ThermalOptions { time_constant: f64::INFINITY, ..options };
    let mut model = ThermalModel::new(slow, &[10.0], None).unwrap();
    model.update(&[10.0], f64::INFINITY);
    assert!(model.heat()[0].abs() < 1e-9);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -4.0..4.0, 1 => any::<f64>(), 1 => 1e-320..1e-300, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Invalid readings and times give finite goals and limits within the servos' torque, and no panic.
    #[test]
    fn hostile_ticks_give_finite_commands(
        ticks in proptest::collection::vec(
            (proptest::array::uniform7(any_number()), proptest::array::uniform7(any::<bool>()), any_number(), any_number()),
            1..60,
        ),
        rest in any::<bool>(),
    ) {
        let (model, servos) = (Arc::new(arm7()), servos());
        let rest_q = [0.1; 7];
        let mut down = lowering(&model, &servos, &LoweringStart { rest_q: rest.then_some(&rest_q), ..start(&Q) });
        let mut guiding = guiding(&model, 2.2);
        let mut follower = follower(&model, [FORCE; 3]);
        for (q, fresh, dt, age) in &ticks {
            if let Some(command) = down.step(q, fresh, *dt, *age).unwrap() {
                prop_assert!(command.goal().iter().all(|goal| goal.is_finite()));
                prop_assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)));
                prop_assert!(command.speed_limit().iter().all(|limit| *limit > 0.0));
            }
            if let Ok(command) = guiding.step(q, *dt) {
                prop_assert!(command.goal().iter().all(|goal| goal.is_finite()));
                prop_assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)));
            }
            let target = q.map(|q| if q.is_finite() { -0.5 * q } else { 0.0 });
            if let Ok(command) = follower.step(q, &target, *dt) {
                prop_assert!(command.goal().iter().all(|goal| goal.is_finite()));
                prop_assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)));
            }
        }
    }
}
