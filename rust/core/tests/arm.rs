//! Points, descent, hand guiding, joint follower, position filter, command limiter and thermal model of an arm: tests
//! with a quasi-static arm and with invalid inputs.

use std::sync::Arc;

use pliant_core::arm::{
    CommandLimiter, DEFAULT_SPEED, HandGuidingOptions, JointFollowerOptions, LimiterInput, LoweringPhase,
    LoweringStart, PositionFilter, SUPPORT, SwingResult, ThermalOptions, torque_margin,
};
use pliant_core::kinematics::{ArmPoints, Reference};
use pliant_core::{Command, HandGuiding, JointFollower, JointVec, Lowering, MAX_JOINTS, Model, Servos, ThermalModel};
use proptest::prelude::*;

use crate::common::arm7;

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

/// Returns the joint positions at which servos of stiffness `kp` [N·m/rad] hold the arm with the goals `goal` [rad].
fn equilibrium(model: &Model, goal: &[f64], kp: f64, q: &[f64]) -> Vec<f64> {
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
fn points_and_tool_agree_with_jacobians_and_model() {
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
fn effective_mass_agrees_with_an_impulse() {
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

/// The servos are stiffer or softer than the servo table says, which must not matter: the descent uses measured
/// positions.
#[test]
fn a_quasi_static_arm_is_lowered_despite_a_wrong_stiffness() {
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
            q = equilibrium(&model, command.goal(), kp, &q);
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
fn without_positions_the_descent_follows_the_model_with_speed_limits() {
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
fn errors_name_wrong_lengths_and_numbers() {
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

/// A drive may report a torque limit above the usable torque, or a lost register as a negative number.
#[test]
fn a_descent_starts_within_the_usable_torque() {
    let (model, servos) = (Arc::new(arm7()), servos());
    let sent = [1e6, -3.0, 20.0, TORQUE, 5.0, 0.0, 1e6];
    let mut down = lowering(&model, &servos, &LoweringStart { torque_limit: Some(&sent), ..start(&Q) });
    for _ in 0..3 {
        // Without a new position, the limits do not change.
        let command = down.step(&Q, &[false; 7], DT, 0.0).unwrap().unwrap();
        assert!(command.torque_limit().iter().all(|limit| (0.0..=TORQUE).contains(limit)), "{command:?}");
        assert!((command.torque_limit()[4] - 5.0).abs() < 1e-12);
    }
}

#[test]
fn errors_name_invalid_options_of_hand_guiding() {
    let model = Arc::new(arm7());
    let swing = SwingResult { q: &Q, goal: &Q, swung: &[true; 7], lead: &[0.0; 7], friction: &[1e-3; 7] };
    let usual = HandGuidingOptions { stiffness_error: 2.0, delay: 0.0, torque_share: 0.3, payload_moments: [0.0; 4] };
    let refused = |options: HandGuidingOptions| {
        HandGuiding::new(Arc::clone(&model), &servos(), &[0.5; 7], &swing, options).unwrap_err().to_string()
    };
    for (options, expected) in [
        (HandGuidingOptions { stiffness_error: 0.9, ..usual }, "stiffness_error = 0.9"),
        (HandGuidingOptions { delay: f64::NAN, ..usual }, "delay [s] = NaN"),
        (HandGuidingOptions { delay: 20.0, ..usual }, "delay [s] = 20 is outside [0, 0.5]"),
        (HandGuidingOptions { torque_share: -0.1, ..usual }, "torque_share = -0.1"),
        (HandGuidingOptions { payload_moments: [-1.0, 0.0, 0.0, 0.0], ..usual }, "payload_moments[0] [kg] = -1"),
        (HandGuidingOptions { payload_moments: [1.0, 0.0, f64::INFINITY, 0.0], ..usual }, "payload_moments[2]"),
    ] {
        assert!(refused(options).contains(expected), "{}", refused(options));
    }
}

/// If the system clock is set during hand guiding, the period can be any number.
#[test]
fn huge_periods_do_not_move_goals_far() {
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
        // Only the stiffness of a loaded joint can be measured.
        if gravity[i].abs() > 1.0 {
            assert!(high[i] / low[i] < 1.5, "joint {i}: {} to {}", low[i], high[i]);
        }
    }
}

#[test]
fn a_guided_arm_stays_where_the_hand_releases_it() {
    let model = Arc::new(arm7());
    let mut guiding = guiding(&model, 1.1);
    let mut goal = vec![0.0; 7];
    for _ in 0..100 {
        goal = guiding.step(&Q, DT).unwrap().goal().to_vec();
    }
    let start_q = equilibrium(&model, &goal, KP, &Q);
    assert!(start_q.iter().zip(&Q).all(|(a, b)| (a - b).abs() < 5e-3), "{start_q:?}");
    let mut q = Q;
    for tick in 0..200 {
        q[1] = Q[1] + 0.3 * f64::from(tick) / 200.0;
        guiding.step(&q, DT).unwrap();
    }
    for _ in 0..100 {
        goal = guiding.step(&q, DT).unwrap().goal().to_vec();
    }
    let final_q = equilibrium(&model, &goal, KP, &q);
    assert!(final_q.iter().zip(&q).all(|(a, b)| (a - b).abs() < 2e-2), "{final_q:?} {q:?}");
}

const FORCE: f64 = 5.0; // [N]

fn follower(model: &Arc<Model>, max_force: [f64; 3]) -> JointFollower {
    let options = JointFollowerOptions { max_force, max_tool_speed: 0.6, max_joint_speed: 4.0 };
    JointFollower::new(Arc::clone(model), &servos(), options).unwrap()
}

/// Returns the torques that servos with limited torque exert at q, minus those that hold the arm.
fn torques_above_weight(model: &Model, command: &Command, q: &[f64]) -> Vec<f64> {
    let gravity = model.gravity(q).unwrap();
    (0..q.len())
        .map(|i| {
            let limit = command.torque_limit()[i];
            (KP * (command.goal()[i] - q[i])).clamp(-limit, limit) - gravity[i]
        })
        .collect()
}

#[test]
fn a_follower_at_its_target_exerts_only_the_weight() {
    let model = Arc::new(arm7());
    let mut follower = follower(&model, [FORCE; 3]);
    for _ in 0..10 {
        let command = follower.step(&Q, &Q, DT).unwrap();
        assert!(torques_above_weight(&model, &command, &Q).iter().all(|torque| torque.abs() < 1e-12));
    }
}

#[test]
fn a_blocked_follower_exerts_its_force_without_windup() {
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
        for (i, torque) in torques_above_weight(&model, &command, &Q).iter().enumerate() {
            let lever = jacobian[(axis, i)].abs().max(0.1 * jacobian[(axis + 3, i)].abs());
            let expected_torque = FORCE * lever + friction[i];
            assert!(
                (torque.abs() - expected_torque).abs() < 1e-9,
                "axis {axis}, joint {i}: {torque} and {expected_torque}"
            );
            assert!((command.goal()[i] - Q[i]).abs() < 0.2, "joint {i} wound up to {}", command.goal()[i]);
        }
        // The force vanishes once the reference has returned.
        for _ in 0..20 {
            command = follower.step(&Q, &Q, DT).unwrap();
        }
        assert!(torques_above_weight(&model, &command, &Q).iter().all(|torque| torque.abs() < 0.1), "{command:?}");
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
        let next = equilibrium(&model, command.goal(), KP, &q);
        let before = model.forward_kinematics(&q).unwrap().position;
        let after = model.forward_kinematics(&next).unwrap().position;
        let path: f64 = before.iter().zip(&after).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        fastest = fastest.max(path / DT);
        q = next;
    }
    // The feed-forward of damping makes the tool slightly faster than its limit of 0.6 m/s.
    assert!(fastest > 0.3 && fastest < 0.8, "{fastest} m/s");
    assert!(q.iter().zip(model.upper()).all(|(q, upper)| *q < upper + 1e-2), "{q:?}");
}

#[test]
fn a_follower_rejects_invalid_inputs() {
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

/// A torque that could not be read (NaN) heats like the usable torque, and never makes a torque limit NaN.
#[test]
fn nan_torques_heat() {
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

#[test]
fn a_jump_is_rejected_until_the_joint_can_have_moved_there() {
    let mut filter = PositionFilter::new(&[1.0, 1.0]).unwrap();
    let mut read = |position: [f64; 2], ok: [bool; 2], time: f64| {
        let accepted = filter.update(&position, &ok, &[time; 2]).to_vec();
        (accepted, filter.clone())
    };
    assert_eq!(read([0.0, 3.0], [true, true], 0.00).0, [true, true]);
    // 2 × 1 rad/s × 10 ms + 0.2 rad = 0.22 rad.
    assert_eq!(read([0.219, 3.221], [true, true], 0.01).0, [true, false]);
    // The accepted distance does not grow while implausible positions arrive every 10 ms.
    for tick in 2..9 {
        let (accepted, filter) = read([0.219, 3.23], [true, true], 0.01 * f64::from(tick));
        assert_eq!(accepted, [true, false]);
        assert_eq!(filter.rejected()[1], u32::try_from(tick).unwrap());
        assert!((filter.position()[1] - 3.0).abs() < 1e-12 && filter.time()[1].abs() < 1e-12);
    }
    // A joint that is not read keeps its position. After a gap of more than 0.1 s, the accepted distance has grown.
    assert_eq!(read([0.3, 3.23], [false, false], 0.1).0, [false, false]);
    let (accepted, mut filter) = read([0.3, 3.23], [true, true], 0.25);
    assert_eq!(accepted, [true, true]);
    assert_eq!((filter.jumps(), filter.rejected()), (8, &[0, 0][..]));
    filter.reset();
    assert_eq!(filter.update(&[9.0, f64::NAN], &[true, true], &[0.0, 0.0]), [true, false]);
    assert!(PositionFilter::new(&[1.0, f64::NAN]).unwrap_err().to_string().contains("max_speed[1]"));
}

#[test]
fn an_assumed_position_lasts_until_the_first_reading() {
    let mut filter = PositionFilter::new(&[1.0, 0.0]).unwrap();
    assert_eq!(filter.update(&[0.1, f64::NAN], &[true, false], &[0.0; 2]), [true, false]);
    filter.assume(&[5.0, 2.0], 0.01);
    assert_eq!(filter.position(), [0.1, 2.0]);
    // Joint 1 is read far from its assumed position; its largest speed is 0.
    assert_eq!(filter.update(&[0.1, -1.0], &[true, true], &[0.02; 2]), [true, true]);
    assert_eq!(filter.position(), [0.1, -1.0]);
    assert_eq!(filter.update(&[0.1, 2.0], &[true, true], &[0.03; 2]), [true, false]);
}

/// Returns a limiter for a drive with a gripper and then the seven joints in reverse order, and its thermal model.
fn limiter(model: &Model) -> (CommandLimiter, ThermalModel) {
    let (kp, torque) = ([KP; 8], [TORQUE; 8]);
    let options =
        ThermalOptions { continuous: 0.4, time_constant: 30.0, supply: Some(4.0), shutdown_temperature: 70.0 };
    let thermal = ThermalModel::new(options, &torque, Some(&[2.0; 8])).unwrap();
    (CommandLimiter::new(model, &servos(), &[7, 6, 5, 4, 3, 2, 1], &kp, &torque).unwrap(), thermal)
}

#[test]
fn commands_are_limited_to_position_ranges_ramp_and_budgets() {
    let model = arm7();
    let (mut limiter, mut thermal) = limiter(&model);
    let gravity = model.gravity(&Q).unwrap().as_slice().to_vec();
    let position: Vec<f64> = std::iter::once(0.5).chain(Q.iter().rev().copied()).collect();
    let far: Vec<f64> = model.upper().iter().map(|upper| upper + 0.9).collect();
    let input = LimiterInput {
        goal: &far,
        torque_limit: &[100.0; 7],
        gravity: &gravity,
        position: &position,
        off_chain: &[[0.7, 3.0]],
        ramp: 0.0,
        ramp_start: &[0.0; 7],
        may_lead: false,
    };
    let margin = torque_margin(&servos(), &gravity);
    let (goals, limits) = limiter.limit(&thermal, &input).unwrap();
    assert_eq!((goals[0].to_bits(), limits[0].to_bits()), (0.7_f64.to_bits(), 3.0_f64.to_bits()));
    for i in 0..7 {
        let lead = (gravity[i] / KP).max(0.0);
        assert!((goals[7 - i] - (model.upper()[i] + lead)).abs() < 1e-12);
        let holding = SUPPORT * gravity[i].abs() + margin[i];
        assert!(limits[7 - i] <= holding.min(TORQUE) + 1e-12 && limits[7 - i] >= SUPPORT * gravity[i].abs() - 1e-12);
    }
    // Goals may lead by the full torque, the ramp is over, and the supply delivers 4 A to seven servos of 2 A.
    let (goals, limits) = limiter.limit(&thermal, &LimiterInput { may_lead: true, ramp: 2.0, ..input }).unwrap();
    assert!((goals[7] - (model.upper()[0] + TORQUE / KP)).abs() < 1e-12);
    let amperes: f64 = limits[1..].iter().map(|limit| 2.0 / TORQUE * limit).sum();
    assert!((3.9..4.0).contains(&amperes), "{amperes}");
    // Hot servos are limited to their continuous torque, but still hold the weight.
    for _ in 0..8 {
        limiter.update_heat(&mut thermal, [&[9.0; 8], &[TORQUE; 8]], &[0.0; 8], None, 1e6).unwrap();
    }
    assert!(thermal.heat().iter().all(|heat| (heat - 6.25).abs() < 1e-6) && thermal.is_too_hot(1.3));
    let (_, limits) = limiter.limit(&thermal, &LimiterInput { ramp: 1.0, ..input }).unwrap();
    for i in 0..7 {
        assert!(limits[7 - i] <= (0.4 * TORQUE).max(SUPPORT * gravity[i].abs()) + 1e-12);
    }
    // A measured load replaces the estimated torque; NaN does not.
    let load: Vec<f64> = (0..8).map(|i| if i == 3 { -0.4 * TORQUE } else { f64::NAN }).collect();
    limiter.update_heat(&mut thermal, [&[9.0; 8], &[TORQUE; 8]], &[0.0; 8], Some(&load), 1e6).unwrap();
    assert!((thermal.heat()[3] - 1.0).abs() < 1e-6 && (thermal.heat()[2] - 6.25).abs() < 1e-6);
}

#[test]
fn errors_of_the_limiter_name_the_argument() {
    let model = arm7();
    let (mut limiter, thermal) = limiter(&model);
    let mut goal = Q;
    assert_eq!(limiter.unreachable(&goal), None);
    goal[2] = model.upper()[2] + 1.0 + TORQUE / KP - 1e-9;
    assert_eq!(limiter.unreachable(&goal), None);
    goal[2] += 1e-6;
    assert_eq!(limiter.unreachable(&goal), Some(2));
    let input = LimiterInput {
        goal: &Q,
        torque_limit: &[1.0; 7],
        gravity: &[0.0; 7],
        position: &[0.0; 8],
        off_chain: &[[0.0; 2]],
        ramp: 1.0,
        ramp_start: &[0.0; 7],
        may_lead: false,
    };
    let mut refused = |input: &LimiterInput<'_>| limiter.limit(&thermal, input).unwrap_err().to_string();
    assert!(refused(&LimiterInput { goal: &Q[..6], ..input }).contains("goal has shape (6,)"));
    assert!(refused(&LimiterInput { position: &Q, ..input }).contains("position"));
    assert!(refused(&LimiterInput { off_chain: &[], ..input }).contains("off_chain"));
    assert!(refused(&LimiterInput { goal: &[f64::NAN; 7], ..input }).contains("goal[0]"));
    assert!(refused(&LimiterInput { torque_limit: &[-1.0; 7], ..input }).contains("limit[0]"));
    assert!(refused(&LimiterInput { goal: &goal, ..input }).contains("goal[2]"));
    assert_eq!(limiter.speeds(&[1.0; 7]).unwrap(), [f64::INFINITY, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    assert!(limiter.speeds(&[-1.0; 7]).unwrap_err().to_string().contains("velocity"));
    assert!(limiter.speeds(&[1.0; 8]).unwrap_err().to_string().contains("velocity has shape (8,)"));
    let create = |chain: &[usize], kp: &[f64]| CommandLimiter::new(&model, &servos(), chain, kp, &[1.0; 7]);
    assert!(create(&[0, 1, 2, 3, 4, 5, 5], &[1.0; 7]).unwrap_err().to_string().contains("chain"));
    assert!(create(&[0, 1, 2, 3, 4, 5, 7], &[1.0; 7]).unwrap_err().to_string().contains("below 7"));
    assert!(create(&[0, 1, 2, 3, 4, 5, 6], &[0.0; 7]).unwrap_err().to_string().contains("kp"));
    assert!(create(&[0, 1, 2, 3, 4, 5, 6], &[1.0; 8]).unwrap_err().to_string().contains("max_torque"));
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -4.0..4.0, 1 => any::<f64>(), 1 => 1e-320..1e-300, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Invalid positions, times, ramps and torques give finite goals, and limits within the servos' torque.
    #[test]
    fn hostile_readings_give_limited_commands(
        ticks in proptest::collection::vec(
            (
                proptest::array::uniform8(any_number()),
                proptest::array::uniform8(any::<bool>()),
                proptest::array::uniform7(any_number()),
                (any_number(), any_number(), any::<bool>()),
            ),
            1..40,
        ),
    ) {
        let model = arm7();
        let (mut limiter, mut thermal) = limiter(&model);
        let mut filter = PositionFilter::new(&[2.0; 8]).unwrap();
        let (mut goals, mut limits) = ([0.0; 8], [0.0; 8]);
        for (position, ok, command, (time, ramp, may_lead)) in &ticks {
            for (i, accepted) in filter.update(position, ok, &[*time; 8]).iter().enumerate() {
                prop_assert!(!accepted || (ok[i] && position[i].is_finite()));
            }
            prop_assert!(filter.position().iter().all(|q| q.is_nan() || q.is_finite()));
            limiter.update_heat(&mut thermal, [&goals, &limits], filter.position(), Some(position), 0.01).unwrap();
            // Goals that the arm can reach; an infinite command is refused for its torque limit.
            let goal = command.map(|value| value.clamp(-1.0, 1.0));
            let input = LimiterInput {
                goal: &goal,
                torque_limit: command,
                gravity: &[1.0; 7],
                position,
                off_chain: &[[0.0, 1.0]],
                ramp: *ramp,
                ramp_start: command,
                may_lead: *may_lead,
            };
            let valid = command.iter().all(|value| value.is_finite() && *value >= 0.0);
            let Ok(limited) = limiter.limit(&thermal, &input) else {
                prop_assert!(!valid);
                continue;
            };
            prop_assert!(valid);
            goals.copy_from_slice(limited.0);
            limits.copy_from_slice(limited.1);
            prop_assert!(goals.iter().all(|goal| goal.is_finite()));
            prop_assert!(limits.iter().all(|limit| (0.0..=TORQUE).contains(limit)));
            for i in 0..7 {
                prop_assert!(limits[7 - i] <= command[i]);
            }
        }
    }

    /// Invalid readings and times give finite goals, and limits within the servos' torque.
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
