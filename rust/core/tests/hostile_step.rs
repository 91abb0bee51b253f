//! Arbitrary numbers give a finite command or a typed error, and an error does not change the controller.
//!
//! Runs 10⁵ random inputs by default; the environment variable `PLIANT_HOSTILE` sets another number.

use std::sync::Arc;

use pliant_core::params::{
    Axis, Compensation, CompliantSide, Damping, Follow, Frame, Gain, GravityUse, Law, LimitRule, NullSpace,
    OnDeviationLimit, PaperOptions, Profile, Projector, Task, TorqueLimits, Tracking,
};
use pliant_core::{Controller, Error, LimitType, Model, ModelOptions, Payload, Pose, Servos, Settings, StepInput};

use crate::cases;
use crate::seeded::{self, Random};

fn inputs() -> usize {
    std::env::var("PLIANT_HOSTILE").ok().and_then(|count| count.parse().ok()).unwrap_or(100_000)
}

const STRANGE: [f64; 22] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    1e308,
    -1e308,
    f64::MIN_POSITIVE,
    5e-324,
    -5e-324,
    0.0,
    -0.0,
    1e-300,
    1e-12,
    1e6,
    -1e6,
    999_999.0,
    1e3,
    1e-3,
    10.0,
    1.0,
    -1.0,
    std::f64::consts::PI,
    1e16,
];

fn hostile_number(random: &mut Random) -> f64 {
    random.pick(&STRANGE)
}

/// Returns `usual` with a `share` of its numbers replaced by hostile ones, sometimes with a wrong length.
fn numbers(random: &mut Random, usual: &[f64], share: f64) -> Vec<f64> {
    let length = if random.chance(0.05) { random.below(20) } else { usual.len() };
    (0..length)
        .map(|i| if random.chance(share) { hostile_number(random) } else { usual.get(i).copied().unwrap_or(0.1) })
        .collect()
}

fn pose(random: &mut Random, usual: &Pose, share: f64) -> Pose {
    let mut out = *usual;
    out.position.iter_mut().chain(out.rotation.iter_mut().flatten()).for_each(|value| {
        if random.chance(share) {
            *value = hostile_number(random);
        }
    });
    if random.chance(0.05) {
        out.rotation[0].swap(0, 1);
    }
    out
}

/// Calls the controller once with partly hostile inputs; returns the error if the call was rejected.
fn call_with_strange_inputs(
    random: &mut Random,
    controller: &mut Controller,
    q: &[f64],
    target: &Pose,
) -> Option<Error> {
    let share = random.pick(&[0.0, 0.02, 0.3]);
    let n = q.len();
    let q = numbers(random, q, share);
    let target = pose(random, target, share);
    match random.below(12) {
        0 => controller.reset(&q).err(),
        1 => {
            let payload = Payload {
                mass: hostile_number(random),
                com: std::array::from_fn(|_| if random.chance(0.3) { hostile_number(random) } else { 0.1 }),
            };
            controller.set_payload(random.chance(0.9).then_some(&payload)).err()
        }
        2 => controller.set_gravity(std::array::from_fn(|_| hostile_number(random))).err(),
        3 => controller.set_delay(hostile_number(random)).err(),
        4 => controller.step_joints(&q, &numbers(random, &vec![0.1; n], share), &StepInput::default()).err(),
        5 => controller.capture_gravity(&q, &numbers(random, &vec![0.1; n], share)).err(),
        _ => {
            let dq = numbers(random, &vec![0.1; n], share);
            let gradient = numbers(random, &vec![0.1; n], share);
            let posture = numbers(random, &vec![0.1; n], share);
            let twist: [f64; 6] =
                std::array::from_fn(|_| if random.chance(share) { hostile_number(random) } else { 0.1 });
            let input = StepInput {
                dt: random.chance(0.3).then(|| hostile_number(random)),
                dq: random.chance(0.3).then_some(&dq),
                twist: random.chance(0.3).then_some(&twist),
                gradient: random.chance(0.3).then_some(&gradient),
                posture: random.chance(0.3).then_some(&posture),
            };
            match controller.step(&q, &target, &input) {
                Ok(command) => {
                    let sent = command.goal().iter().chain(command.torque_limit());
                    assert!(sent.clone().all(|x| x.is_finite()), "{command:?}");
                    assert!(command.torque_limit().iter().all(|&x| x >= 0.0));
                    assert!(command.speed_limit().iter().all(|&x| x > 0.0));
                    None
                }
                Err(error) => Some(error),
            }
        }
    }
}

fn assert_named(error: &Error) {
    let text = error.to_string();
    assert!(text.len() > 5 && !text.starts_with(':') && !text.starts_with(' '), "{text}");
    assert!(!matches!(error, Error::Urdf { .. } | Error::FrameNotFound { .. }), "{text}");
}

fn make(random: &mut Random, index: usize) -> Controller {
    let model = seeded::arm(index, &ModelOptions::default());
    loop {
        let settings = Settings {
            max_tool_speed: random.pick(&[[0.25, 1.0], [f64::INFINITY; 2], [0.25, f64::INFINITY]]),
            tracking: Tracking {
                integrate: random.pick(&[0.0, 2.0]),
                ..{
                    let law = random.pick(&[Law::Cap, Law::Impedance, Law::Paper]);
                    cases::settings(random, &model, law)
                }
                .tracking
            },
            paper_options: PaperOptions {
                manipulability: random.pick(&[0.0, 0.1]),
                ..{
                    let law = random.pick(&[Law::Cap, Law::Impedance, Law::Paper]);
                    cases::settings(random, &model, law)
                }
                .paper_options
            },
            ..{
                let law = random.pick(&[Law::Cap, Law::Impedance, Law::Paper]);
                cases::settings(random, &model, law)
            }
        };
        let servos = cases::servos(random, &seeded::servos(index), model.n());
        if let Ok(controller) = Controller::new(Arc::clone(&model), settings, Some(servos)) {
            return controller;
        }
    }
}

#[test]
fn rejected_inputs_change_nothing() {
    let mut random = Random::new(41);
    let random = &mut random;
    let (mut done, mut refused) = (0, 0);
    while done < inputs() {
        let mut controller = make(random, done % 3);
        let model = Arc::clone(controller.model());
        let mut q = random.joints(&model, 0.9);
        let target = random.target(&model, &q, 0.1, 0.5);
        for _ in 0..200 {
            for value in &mut q {
                *value += random.between(-1e-3, 1e-3);
            }
            let untouched = controller.clone();
            done += 1;
            if let Some(error) = call_with_strange_inputs(random, &mut controller, &q, &target) {
                assert_named(&error);
                refused += 1;
                // After an error, the next step is bit-identical to that of a copy made before the call.
                let mut copy = untouched;
                let a = *controller.step(&q, &target, &StepInput::default()).unwrap();
                let b = *copy.step(&q, &target, &StepInput::default()).unwrap();
                assert_eq!(a, b, "{error}");
                assert_eq!(format!("{:?}", controller.diagnostics()), format!("{:?}", copy.diagnostics()), "{error}");
            }
        }
        // After hostile inputs, usual readings give usual commands again.
        controller.set_gravity([0.0, 0.0, -9.81]).unwrap();
        controller.set_payload(None).unwrap();
        controller.reset(&q).unwrap();
        for _ in 0..3 {
            controller.step(&q, &target, &StepInput::default()).unwrap();
        }
    }
    assert!(refused > done / 10 && refused < done * 9 / 10, "{refused} of {done}");
}

#[test]
fn tiny_periods_give_finite_commands() {
    for law in [Law::Cap, Law::Impedance, Law::Paper] {
        let model = seeded::arm(0, &ModelOptions::default());
        let settings = Settings {
            law,
            delay: 0.02,
            tracking: Tracking { integrate: 1.0, ..Tracking::default() },
            ..Settings::default()
        };
        let mut controller = Controller::new(Arc::clone(&model), settings, Some(seeded::servos(0))).unwrap();
        let q = [-0.1, -0.6, 0.7, -1.7, 0.9, 0.6, -0.1];
        let target = model.forward_kinematics(&q).unwrap();
        controller.step(&q, &target, &StepInput::default()).unwrap();
        for dt in [5e-324, 1e-308, 1e-200, 1e-20] {
            let moved = q.map(|x| x + 0.5);
            let command =
                *controller.step(&moved, &target, &StepInput { dt: Some(dt), ..StepInput::default() }).unwrap();
            assert!(command.goal().iter().chain(command.torque_limit()).all(|x| x.is_finite()));
        }
        for _ in 0..200 {
            controller.step(&q, &target, &StepInput::default()).unwrap();
        }
        let goal = controller.step(&q, &target, &StepInput::default()).unwrap().goal().to_vec();
        assert!(goal.iter().zip(q).all(|(g, q)| (g - q).abs() < 0.1), "{goal:?}");
    }
}

fn optional<T>(random: &mut Random, make: impl FnOnce(&mut Random) -> T) -> Option<T> {
    random.chance(0.2).then(|| make(random))
}

fn random_damping(random: &mut Random, number: impl Fn(&mut Random) -> f64) -> Damping {
    match random.below(4) {
        0 => Damping::Fixed(number(random)),
        1 => Damping::Adaptive { lambda_0: number(random), sigma_0: number(random), lambda_max: number(random) },
        _ => Damping::Auto,
    }
}

/// Returns random settings, valid or not.
fn random_settings(random: &mut Random, n: usize) -> Settings {
    let number =
        |random: &mut Random| if random.chance(0.05) { hostile_number(random) } else { random.scale(1e-3, 20.0) };
    let list = |random: &mut Random| {
        let length = if random.chance(0.9) { n } else { random.below(20) };
        (0..length)
            .map(|_| if random.chance(0.01) { hostile_number(random) } else { random.scale(1e-3, 20.0) })
            .collect::<Vec<_>>()
    };
    let gain = |random: &mut Random, size: usize| match random.below(5) {
        0 => Gain::Diagonal(list(random)),
        1 => {
            let size = if random.chance(0.9) { size } else { random.below(8) };
            Gain::Matrix((0..size).map(|_| random.vector(size, 2.0)).collect())
        }
        _ => Gain::Scalar(if random.chance(0.1) { hostile_number(random) } else { random.between(0.0, 6.0) }),
    };
    let law = random.pick(&[Law::Cap, Law::Impedance, Law::Paper]);
    // Springs are valid under law `impedance` only; use them rarely with other laws.
    let springs = law == Law::Impedance || random.chance(0.02);
    let axis = |random: &mut Random| Axis {
        soft: optional(random, |r| [number(r), number(r)]),
        firm: optional(random, |r| [number(r), number(r)]),
        hold: optional(random, number),
        stiffness: if springs { optional(random, |r| [number(r), 100.0 * number(r)]) } else { None },
        damping: if springs { optional(random, |r| [number(r), number(r)]) } else { None },
        yields: optional(random, |r| {
            r.pick(&[CompliantSide::Both, CompliantSide::Plus, CompliantSide::Minus, CompliantSide::None])
        }),
        adaptation: if random.chance(0.6) { 0.0 } else { number(random) },
        soft_until: optional(random, |r| number(r) * 0.01),
        firm_from: optional(random, number),
        profile: random.pick(&[Profile::Hardening, Profile::Constant, Profile::Softening]),
        max_velocity: optional(random, number),
        soft_step_limit: optional(random, number),
        deviation_limit: if random.chance(0.8) { None } else { Some(0.1 * number(random)) },
        on_deviation_limit: random.pick(&[OnDeviationLimit::Yield, OnDeviationLimit::Wait]),
    };
    let usual = Settings::default();
    let or = |random: &mut Random, usual: f64| if random.chance(0.93) { usual } else { number(random) };
    let on: [bool; 6] = std::array::from_fn(|_| random.chance(0.7));
    let mut rotation = random.rotation();
    if random.chance(0.1) {
        rotation[1][2] = hostile_number(random);
    }
    Settings {
        gravity: random.chance(0.75),
        task: Task {
            axes: on,
            frame: random.pick(&[Frame::Base, Frame::Tool, Frame::Rotation(rotation)]),
            length: optional(random, number),
        },
        axes: std::array::from_fn(|a| if on[a] && random.chance(0.4) { axis(random) } else { Axis::default() }),
        law,
        rate: or(random, usual.rate),
        delay: or(random, 0.0),
        max_tool_speed: [or(random, 0.25), or(random, 1.0)],
        max_tool_acceleration: [or(random, 1.0), or(random, 4.0)],
        accept_high_adaptation: random.chance(0.5),
        accept_high_stiffness: random.chance(0.2),
        tracking: Tracking {
            gain: gain(random, on.iter().filter(|&&x| x).count()),
            damping: random_damping(random, number),
            velocity_filter: or(random, 0.02),
            goal_slew: or(random, 1.0),
            joint_speed: optional(random, list),
            integrate: or(random, 0.0),
        },
        null_space: NullSpace {
            projector: random.pick(&[Projector::Exact, Projector::Paper]),
            gain: optional(random, number),
            posture: optional(random, list),
            limit_avoidance: or(random, 0.0),
            max_torque: optional(random, number),
            stiffness: if springs { optional(random, number) } else { None },
            max_speed: or(random, f64::INFINITY),
        },
        compensation: Compensation { friction: or(random, 0.9), damping: or(random, 0.8), delay: or(random, 0.9) },
        torque_limits: TorqueLimits {
            stiffening_time: or(random, 0.2),
            floor: optional(random, list),
            margin: or(random, 0.1),
            // Rarely, because each step with this bound simulates six pushes, which is slow.
            max_host_loss_force: if random.chance(0.02) { Some(number(random).abs()) } else { None },
        },
        paper_options: PaperOptions {
            follow: optional(random, |r| r.pick(&[Follow::Free, Follow::Hold])),
            limits: random.pick(&[LimitRule::Demand, LimitRule::Sum]),
            horizon: or(random, usual.paper_options.horizon),
            kq: gain(random, n),
            posture_weights: optional(random, list),
            manipulability: or(random, 0.0),
            gravity_use: random.pick(&[GravityUse::Both, GravityUse::Goal, GravityUse::Limits, GravityUse::Off]),
            gravity_scale: or(random, 1.1),
            friction_speed: or(random, 0.05),
            direction_band: optional(random, number),
            raw_deviation: random.chance(0.2),
            budget_on_goal: random.chance(0.2),
            joint_weights: optional(random, list),
            lead_limit: optional(random, number),
        },
    }
}

fn random_servos(random: &mut Random, index: usize, n: usize) -> Servos {
    let mut servos = seeded::servos(index).for_joints(n).unwrap();
    if random.chance(0.2) {
        let fields = [
            &mut servos.kp,
            &mut servos.max_torque,
            &mut servos.friction,
            &mut servos.damping,
            &mut servos.encoder_step,
        ];
        for field in fields {
            if random.chance(0.3) {
                field[random.below(n)] = hostile_number(random);
            }
        }
    }
    if random.chance(0.2) {
        servos.limit_type = LimitType::Pwm;
        servos.no_load_speed = optional(random, |r| vec![hostile_number(r)]);
    }
    servos
}

fn run_steps(random: &mut Random, model: &Arc<Model>, controller: &mut Controller) {
    let q = random.joints(model, 0.9);
    let target = random.target(model, &q, 0.1, 0.5);
    for _ in 0..3 {
        match controller.step(&q, &target, &StepInput::default()) {
            Ok(command) => assert!(command.goal().iter().chain(command.torque_limit()).all(|x| x.is_finite())),
            Err(error) => assert_named(&error),
        }
    }
}

#[test]
fn arbitrary_settings_are_accepted_or_rejected_by_name() {
    let mut random = Random::new(42);
    let random = &mut random;
    let arms: Vec<Arc<Model>> = (0..3).map(|index| seeded::arm(index, &ModelOptions::default())).collect();
    let (mut accepted, mut updated) = (0, 0);
    for round in 0..6000 {
        let (index, model) = (round % 3, &arms[round % 3]);
        let settings = random_settings(random, model.n());
        let servos = random.chance(0.9).then(|| random_servos(random, index, model.n()));
        match Controller::new(Arc::clone(model), settings, servos) {
            Ok(mut controller) => {
                accepted += 1;
                run_steps(random, model, &mut controller);
                let before = controller.clone();
                match controller.update(random_settings(random, model.n())) {
                    Ok(()) => updated += 1,
                    Err(error) => {
                        assert_named(&error);
                        assert_eq!(controller.settings(), before.settings());
                    }
                }
                run_steps(random, model, &mut controller);
            }
            Err(error) => assert_named(&error),
        }
    }
    assert!(accepted > 100 && updated > 3, "{accepted} {updated}");
}
