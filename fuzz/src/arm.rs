//! Descent, hand guiding, joint follower and thermal model with arbitrary numbers: each call gives a valid command, or
//! an error that changes nothing.

use std::sync::Arc;

use pliant_core::arm::{HandGuidingOptions, JointFollowerOptions, LoweringStart, SwingResult, ThermalOptions};
use pliant_core::kinematics::ArmPoints;
use pliant_core::{Command, HandGuiding, JointFollower, Lowering, Result, ThermalModel};

use super::arms::{ARMS, Arm, arm};
use super::checks::{assert_explained, assert_sendable, bits};
use super::input::Input;

/// Maximum number of ticks in one run.
const TICKS: usize = 60;

/// Runs the descent, hand guiding, the joint follower or the thermal model on one of the arms.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let arm = arm(input.below(ARMS));
    match input.below(4) {
        0 => lowering(&mut input, arm),
        1 => hand_guiding(&mut input, arm),
        2 => joint_follower(&mut input, arm),
        _ => thermal(&mut input, arm),
    }
}

fn lowering(input: &mut Input, arm: &Arm) {
    let n = arm.model.n();
    let q = input.vector(&arm.q);
    let goal = input.option(|input| input.vector(&arm.q));
    let torque_limit = input.option(|input| input.vector(&arm.servos.max_torque));
    let rest_q = input.option(|input| input.vector(&vec![0.1; n]));
    let start = LoweringStart {
        q: &q,
        goal: goal.as_deref(),
        torque_limit: torque_limit.as_deref(),
        rest_q: rest_q.as_deref(),
        speed: input.number(0.15),
    };
    let points = Arc::new(ArmPoints::new(&arm.model, &arm.servos.armature).unwrap());
    let mut lowering = match Lowering::new(Arc::clone(&arm.model), &arm.servos, points, &start) {
        Ok(lowering) => lowering,
        Err(error) => return assert_explained(&error),
    };
    let mut q = arm.q.clone();
    for _ in 0..TICKS {
        if input.is_empty() {
            break;
        }
        let measured = input.vector(&q);
        let lost = input.byte();
        let fresh: Vec<bool> = (0..measured.len()).map(|i| lost >> (i % 8) & 1 == 0).collect();
        let (dt, age) = (input.number(0.01), input.number(0.01));
        let before = lowering.clone();
        match lowering.step(&measured, &fresh, dt, age) {
            Ok(Some(command)) => {
                assert_sendable(&command, &arm.servos.max_torque);
                // Let the arm follow the goals, so that phases end.
                q.iter_mut().zip(command.goal()).for_each(|(q, goal)| *q = goal.clamp(-3.0, 3.0));
            }
            Ok(None) => return,
            Err(error) => {
                assert_explained(&error);
                let next = |mut lowering: Lowering| {
                    lowering.step(&arm.q, &vec![true; n], 0.01, 0.0).map(|command| command.as_ref().map(bits))
                };
                assert_eq!(next(lowering.clone()), next(before), "the descent has changed after: {error}");
            }
        }
    }
}

fn hand_guiding(input: &mut Input, arm: &Arm) {
    let n = arm.model.n();
    let (q, goal) = (input.vector(&arm.q), input.vector(&arm.q));
    let (lead, friction) = (input.vector(&vec![0.01; n]), input.vector(&vec![0.002; n]));
    let damping = input.vector(&vec![1.0; n]);
    let swung: Vec<bool> = (0..n).map(|_| input.flag()).collect();
    let swing = SwingResult { q: &q, goal: &goal, swung: &swung, lead: &lead, friction: &friction };
    let options = HandGuidingOptions {
        stiffness_error: input.number(1.5),
        delay: input.number(0.01),
        torque_share: input.number(0.1),
        payload_moments: [input.number(0.1), input.number(0.0), input.number(0.0), input.number(0.01)],
    };
    match HandGuiding::new(Arc::clone(&arm.model), &arm.servos, &damping, &swing, options) {
        Ok(guiding) => follow(input, arm, guiding, |guiding, q, _, dt| guiding.step(q, dt)),
        Err(error) => assert_explained(&error),
    }
}

fn joint_follower(input: &mut Input, arm: &Arm) {
    let options = JointFollowerOptions {
        max_force: std::array::from_fn(|_| input.number(10.0)),
        max_tool_speed: input.number(0.3),
        max_joint_speed: input.number(2.0),
    };
    match JointFollower::new(Arc::clone(&arm.model), &arm.servos, options) {
        Ok(follower) => follow(input, arm, follower, JointFollower::step),
        Err(error) => assert_explained(&error),
    }
}

/// Runs ticks with arbitrary positions, targets and periods.
fn follow<T: Clone>(
    input: &mut Input,
    arm: &Arm,
    mut law: T,
    step: impl Fn(&mut T, &[f64], &[f64], f64) -> Result<Command>,
) {
    let mut q = arm.q.clone();
    for _ in 0..TICKS {
        if input.is_empty() {
            break;
        }
        let (measured, target, dt) = (input.vector(&q), input.vector(&arm.q), input.number(0.01));
        let before = law.clone();
        match step(&mut law, &measured, &target, dt) {
            Ok(command) => {
                assert_sendable(&command, &arm.servos.max_torque);
                q = measured;
            }
            Err(error) => {
                assert_explained(&error);
                let next = |mut law: T| step(&mut law, &arm.q, &arm.q, 0.01).map(|command| bits(&command));
                assert_eq!(next(law.clone()), next(before), "the state has changed after: {error}");
            }
        }
    }
}

fn thermal(input: &mut Input, arm: &Arm) {
    let n = arm.model.n();
    let options = ThermalOptions {
        continuous: input.number(0.4),
        time_constant: input.number(60.0),
        supply: input.option(|input| input.number(5.0)),
        shutdown_temperature: input.number(80.0),
    };
    let current = input.option(|input| input.vector(&vec![3.0; n]));
    let mut model = match ThermalModel::new(options, &arm.servos.max_torque, current.as_deref()) {
        Ok(model) => model,
        Err(error) => return assert_explained(&error),
    };
    for _ in 0..TICKS {
        if input.is_empty() {
            break;
        }
        let torque = input.vector(&vec![1.0; n]);
        model.update(&torque, input.number(0.01));
        model.set_temperature(input.below(n), input.number(40.0));
        let mut limit = vec![0.0; n];
        model.torque_ceiling(&mut limit);
        let least = vec![0.1; n];
        model.limit_current(&torque, &least, &mut limit);
        let within = limit.iter().zip(&arm.servos.max_torque).all(|(limit, largest)| (0.0..=*largest).contains(limit));
        assert!(within, "{limit:?}, {model:?}");
    }
}
