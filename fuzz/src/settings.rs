//! Settings, servos and snapshots with arbitrary numbers: a controller whose commands are valid, or an error.

use std::sync::Arc;

use pliant_core::params::{
    Axis, Compensation, CompliantSide, Damping, Follow, Frame, Gain, GravityUse, Law, LimitRule, NullSpace,
    OnDeviationLimit, PaperOptions, Profile, Projector, Task, TorqueLimits, Tracking,
};
use pliant_core::{Controller, LimitType, Payload, Servos, Settings, Snapshot, StepInput};

use super::arms::{ARMS, Arm, arm};
use super::checks::{assert_explained, assert_sendable, bits, ceiling};
use super::input::Input;

/// Creates a controller, steps it before and after an update of its settings, and continues from a changed snapshot.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let arm = arm(input.below(ARMS));
    let n = arm.model.n();
    let settings = settings(&mut input, n);
    let servos = (!input.flag()).then(|| servos(&mut input, &arm.servos));
    let mut controller = match Controller::new(Arc::clone(&arm.model), settings, servos) {
        Ok(controller) => controller,
        Err(error) => return assert_explained(&error),
    };
    steps(&mut controller, arm);
    let untouched = controller.clone();
    if input.flag()
        && let Err(error) = controller.update(self::settings(&mut input, n))
    {
        assert_explained(&error);
        let (mut one, mut other) = (controller.clone(), untouched);
        let next = |controller: &mut Controller| controller.step(&arm.q, &arm.target, &StepInput::default()).map(bits);
        assert_eq!(next(&mut one), next(&mut other), "the controller has changed after: {error}");
    }
    steps(&mut controller, arm);
    if input.flag() {
        let snapshot = snapshot(&mut input, controller.snapshot());
        let (settings, servos) = (controller.settings().clone(), controller.servos().cloned());
        match Controller::from_snapshot(Arc::clone(&arm.model), settings, servos, &snapshot) {
            Ok(mut resumed) => steps(&mut resumed, arm),
            Err(error) => assert_explained(&error),
        }
    }
}

fn steps(controller: &mut Controller, arm: &Arm) {
    let ceiling = ceiling(controller);
    for _ in 0..3 {
        match controller.step(&arm.q, &arm.target, &StepInput::default()) {
            Ok(command) => assert_sendable(command, &ceiling),
            Err(error) => assert_explained(&error),
        }
    }
}

fn snapshot(input: &mut Input, mut snapshot: Snapshot) -> Snapshot {
    snapshot.state = input.vector(&snapshot.state);
    snapshot.gravity = snapshot.gravity.map(|g| input.number(g));
    snapshot.delay = input.number(snapshot.delay);
    snapshot.payload = input.option(|input| Payload { mass: input.number(0.2), com: [0.0, input.number(0.1), 0.0] });
    snapshot.payload_ramp = input.option(|input| std::array::from_fn(|_| input.number(0.1)));
    snapshot.captured = input.option(|input| [input.vector(&[0.01; 7]), input.vector(&[0.0; 7])]);
    snapshot
}

fn servos(input: &mut Input, usual: &Servos) -> Servos {
    let mut servos = usual.clone();
    for _ in 0..input.below(4) {
        let fields = [
            &mut servos.kp,
            &mut servos.max_torque,
            &mut servos.friction,
            &mut servos.load_friction,
            &mut servos.stribeck,
            &mut servos.load_stribeck,
            &mut servos.stribeck_speed,
            &mut servos.damping,
            &mut servos.kv,
            &mut servos.armature,
            &mut servos.encoder_step,
        ];
        let at = input.below(fields.len());
        for (index, field) in fields.into_iter().enumerate() {
            if index == at {
                *field = input.vector(field);
            }
        }
    }
    servos.limit_type = input.pick(&[servos.limit_type, LimitType::Current, LimitType::Pwm]);
    servos.no_load_speed = input.option(|input| input.vector(&[5.0]));
    servos
}

fn gain(input: &mut Input, size: usize, usual: f64) -> Gain {
    match input.below(6) {
        0 => Gain::Diagonal(input.vector(&vec![usual; size])),
        1 => Gain::Matrix((0..size).map(|_| input.vector(&vec![0.3; size])).collect()),
        _ => Gain::Scalar(input.number(usual)),
    }
}

fn axis(input: &mut Input, law: Law) -> Axis {
    let mut pair = |usual: f64| input.option(|input| [input.number(usual), input.number(usual)]);
    let (soft, firm) = (pair(2.0), pair(5.0));
    let (stiffness, damping) = if law == Law::Impedance { (pair(40.0), pair(2.0)) } else { (None, None) };
    Axis {
        soft,
        firm,
        hold: input.option(|input| input.number(10.0)),
        stiffness,
        damping,
        yields: input.option(|input| {
            input.pick(&[CompliantSide::Both, CompliantSide::Plus, CompliantSide::Minus, CompliantSide::None])
        }),
        adaptation: input.number(0.0),
        soft_until: input.option(|input| input.number(0.01)),
        firm_from: input.option(|input| input.number(0.1)),
        profile: input.pick(&[Profile::Hardening, Profile::Constant, Profile::Softening]),
        max_velocity: input.option(|input| input.number(0.1)),
        soft_step_limit: input.option(|input| input.number(0.1)),
        deviation_limit: input.option(|input| input.number(0.05)),
        on_deviation_limit: input.pick(&[OnDeviationLimit::Yield, OnDeviationLimit::Wait]),
    }
}

fn settings(input: &mut Input, n: usize) -> Settings {
    let usual = Settings::default();
    let law = input.pick(&[Law::Cap, Law::Impedance, Law::Paper]);
    let mask = input.byte();
    let on: [bool; 6] = std::array::from_fn(|axis| mask >> axis & 1 == 0);
    let k = on.iter().filter(|on| **on).count();
    let mut axes = [Axis::default(); 6];
    for _ in 0..input.below(3) {
        axes[input.below(6)] = axis(input, law);
    }
    let list = |input: &mut Input, usual: f64| input.option(|input| input.vector(&vec![usual; n]));
    let paper_options = if input.flag() {
        PaperOptions {
            follow: input.option(|input| input.pick(&[Follow::Free, Follow::Hold])),
            limits: input.pick(&[LimitRule::Demand, LimitRule::Sum]),
            horizon: input.number(usual.paper_options.horizon),
            kq: gain(input, n, 1.0),
            joint_weights: list(input, 1.0),
            posture_weights: list(input, 1.0),
            manipulability: input.number(0.0),
            gravity_use: input.pick(&[GravityUse::Both, GravityUse::Goal, GravityUse::Limits, GravityUse::Off]),
            gravity_scale: input.number(1.1),
            friction_speed: input.number(0.05),
            direction_band: input.option(|input| input.number(0.5)),
            raw_deviation: input.flag(),
            budget_on_goal: input.flag(),
            lead_limit: input.option(|input| input.number(0.05)),
        }
    } else {
        usual.paper_options
    };
    Settings {
        task: Task {
            axes: on,
            frame: match input.below(4) {
                0 => Frame::Tool,
                1 => Frame::Rotation([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, input.number(1.0)]]),
                _ => Frame::Base,
            },
            length: if n < 6 { Some(input.number(0.2)) } else { input.option(|input| input.number(0.2)) },
        },
        axes,
        law,
        rate: input.number(usual.rate),
        delay: input.number(usual.delay),
        gravity: !input.flag(),
        max_tool_speed: usual.max_tool_speed.map(|speed| input.number(speed)),
        max_tool_acceleration: usual.max_tool_acceleration.map(|rate| input.number(rate)),
        accept_high_adaptation: input.flag(),
        accept_high_stiffness: input.flag(),
        tracking: Tracking {
            gain: gain(input, k, 4.0),
            damping: match input.below(4) {
                0 => Damping::Fixed(input.number(0.1)),
                1 => Damping::Adaptive {
                    lambda_0: input.number(0.02),
                    sigma_0: input.number(0.15),
                    lambda_max: input.number(0.2),
                },
                _ => Damping::Auto,
            },
            velocity_filter: input.number(0.02),
            goal_slew: input.number(1.0),
            joint_speed: list(input, 1.0),
            integrate: input.number(0.0),
        },
        null_space: NullSpace {
            posture: list(input, 0.1),
            gain: input.option(|input| input.number(2.0)),
            max_torque: input.option(|input| input.number(3.0)),
            stiffness: if law == Law::Impedance { input.option(|input| input.number(2.0)) } else { None },
            max_speed: input.number(f64::INFINITY),
            limit_avoidance: input.number(0.0),
            projector: input.pick(&[Projector::Exact, Projector::Paper]),
        },
        compensation: Compensation {
            friction: input.number(0.9),
            damping: input.number(0.8),
            delay: input.number(0.9),
        },
        torque_limits: TorqueLimits {
            margin: input.number(0.1),
            floor: list(input, 0.5),
            stiffening_time: input.number(0.2),
            max_host_loss_force: input.option(|input| input.number(20.0)),
        },
        paper_options,
    }
}
