//! Random settings, servos and inputs for the control step and for the oracle.

use std::sync::Arc;

use pliant_core::params::{
    Axis, CompliantSide, Damping, Follow, Frame, Gain, GravityUse, Law, LimitRule, NullSpace, OnDeviationLimit,
    PaperOptions, Profile, Projector, Settings, Task, TorqueLimits, Tracking,
};
use pliant_core::{Controller, Model, Servos};

use crate::seeded::Random;

fn axis(random: &mut Random, law: Law, translation: bool, small: bool) -> Axis {
    let unit = match (law, translation, small) {
        (Law::Paper, _, _) | (_, true, true) => 8.0,
        (_, true, false) => 40.0,
        (_, false, false) => 4.0,
        (_, false, true) => 1.0,
    };
    let hold = unit * random.between(0.4, 1.5);
    let firm = [hold * random.between(0.2, 1.0), hold * random.between(0.2, 1.0)];
    let yields = random.pick(&[
        CompliantSide::Both,
        CompliantSide::Both,
        CompliantSide::None,
        CompliantSide::None,
        CompliantSide::Plus,
        CompliantSide::Minus,
    ]);
    let soft_until = random.between(0.0, 0.05);
    let scale = unit * if small { 1.0 } else { 4.0 };
    let mut springs = |max: f64| {
        let pair = [max * random.unit(), max * random.unit()];
        (law == Law::Impedance).then(|| random.pick(&[pair, pair, [0.0, pair[1]], [0.0; 2]]))
    };
    let (stiffness, damping) = (springs(10.0 * scale), springs(0.5 * scale));
    Axis {
        soft: Some([firm[0] * random.unit(), firm[1] * random.unit()]),
        firm: Some(firm),
        hold: Some(hold),
        stiffness,
        damping,
        yields: Some(yields),
        adaptation: if yields == CompliantSide::None { 0.0 } else { random.pick(&[0.0, 0.5, 0.9, 0.999]) },
        soft_until: Some(soft_until),
        firm_from: Some(soft_until + random.between(0.02, 0.4)),
        profile: random.pick(&[Profile::Hardening, Profile::Constant, Profile::Softening]),
        max_velocity: random.pick(&[None, Some(0.05), Some(f64::INFINITY)]),
        soft_step_limit: random.pick(&[None, None, Some(0.1), Some(f64::INFINITY)]),
        deviation_limit: if yields == CompliantSide::Both {
            None
        } else {
            random.pick(&[None, None, Some(if translation { 0.01 } else { 0.03 }), Some(0.1)])
        },
        on_deviation_limit: random.pick(&[OnDeviationLimit::Yield, OnDeviationLimit::Wait]),
    }
}

fn gain(random: &mut Random, size: usize, max: f64) -> Gain {
    match random.below(4) {
        0 => Gain::Diagonal((0..size).map(|_| random.between(0.1, max)).collect()),
        1 => {
            // A dominant diagonal, scaled so that the norm of the matrix is below `max`.
            let scale = max / (1.0 + 0.2 * size as f64);
            let entry =
                |r: usize, c: usize, random: &mut Random| scale * if r == c { 1.0 } else { random.between(-0.2, 0.2) };
            Gain::Matrix((0..size).map(|r| (0..size).map(|c| entry(r, c, random)).collect()).collect())
        }
        _ => Gain::Scalar(random.between(0.3, max)),
    }
}

/// Returns random settings that are valid for `model`, without a tool speed limit.
pub(crate) fn settings(random: &mut Random, model: &Model, law: Law) -> Settings {
    let n = model.n();
    let small = n < 6;
    let length = (n < 6 && random.chance(0.4)).then(|| random.between(0.1, 0.6));
    let mut axes: [bool; 6] = std::array::from_fn(|_| random.chance(0.7));
    if random.chance(0.4) || !axes.contains(&true) {
        axes = [true; 6];
    }
    for axis in [4, 3, 5, 2, 1] {
        if length.is_none() && axes.iter().filter(|&&on| on).count() > n {
            axes[axis] = false;
        }
    }
    let k = axes.iter().filter(|&&on| on).count();
    let frame = match random.below(3) {
        0 => Frame::Base,
        1 => Frame::Tool,
        _ => Frame::Rotation(random.rotation()),
    };
    let works_without_kp = law == Law::Paper && random.chance(0.3);
    let joints =
        |random: &mut Random, low: f64, high: f64| -> Vec<f64> { (0..n).map(|_| random.between(low, high)).collect() };
    let per_axis = std::array::from_fn(|a| if axes[a] { axis(random, law, a < 3, small) } else { Axis::default() });
    Settings {
        task: Task { axes, frame, length },
        axes: per_axis,
        law,
        delay: random.pick(&[0.0, 0.01, 0.02]),
        max_tool_speed: [f64::INFINITY; 2],
        accept_high_adaptation: true,
        tracking: Tracking {
            gain: gain(random, k, 4.0),
            damping: random.pick(&[
                Damping::Auto,
                Damping::Fixed(0.05),
                Damping::Fixed(0.3),
                Damping::Adaptive { lambda_0: 0.02, sigma_0: 0.15, lambda_max: 0.2 },
            ]),
            velocity_filter: random.pick(&[0.0, 0.02]),
            goal_slew: random.pick(&[1.0, f64::INFINITY]),
            joint_speed: random.chance(0.3).then(|| joints(random, 0.05, 3.0)),
            ..Tracking::default()
        },
        null_space: NullSpace {
            projector: random.pick(&[Projector::Exact, Projector::Exact, Projector::Paper]),
            gain: random.pick(&[None, Some(0.0), Some(2.0)]),
            posture: random.chance(0.3).then(|| joints(random, -0.5, 0.5)),
            limit_avoidance: random.pick(&[0.0, 0.0, 0.3]),
            max_torque: if k < n { random.pick(&[None, Some(0.3), Some(8.0)]) } else { None },
            stiffness: if law == Law::Impedance { random.pick(&[None, Some(0.0), Some(2.0)]) } else { None },
            max_speed: random.pick(&[f64::INFINITY, 0.05]),
        },
        torque_limits: TorqueLimits {
            stiffening_time: random.pick(&[0.2, 0.0]),
            floor: random.chance(0.3).then(|| joints(random, 0.0, 1.0)),
            margin: random.pick(&[0.1, 0.0, 0.3]),
            ..TorqueLimits::default()
        },
        paper_options: PaperOptions {
            follow: if works_without_kp || law == Law::Impedance {
                None
            } else {
                random.pick(&[None, Some(Follow::Free), Some(Follow::Hold)])
            },
            limits: random.pick(&[LimitRule::Demand, LimitRule::Demand, LimitRule::Sum]),
            kq: if law == Law::Paper { gain(random, n, 1.5) } else { Gain::Scalar(1.0) },
            posture_weights: random.chance(0.3).then(|| joints(random, 0.0, 1.5)),
            gravity_use: if works_without_kp {
                GravityUse::Limits
            } else {
                random.pick(&[
                    GravityUse::Both,
                    GravityUse::Both,
                    GravityUse::Goal,
                    GravityUse::Limits,
                    GravityUse::Off,
                ])
            },
            gravity_scale: random.pick(&[1.0, 1.1]),
            direction_band: random.pick(&[None, Some(0.0), Some(0.5)]),
            raw_deviation: random.chance(0.2),
            budget_on_goal: law == Law::Paper && !works_without_kp && random.chance(0.5),
            joint_weights: if law == Law::Paper && random.chance(0.3) { Some(joints(random, 0.3, 3.0)) } else { None },
            lead_limit: random.pick(&[None, None, Some(0.05), Some(f64::INFINITY)]),
            ..PaperOptions::default()
        },
        ..Settings::default()
    }
}

/// Returns `settings`, changed until this arm accepts them: stiffness and damping of the axes are reduced in steps of
/// 30 %, and the pseudo-inverse gets a constant damping if the axes cannot be moved independently.
pub(crate) fn accepted_settings(model: &Arc<Model>, mut settings: Settings, servos: Option<&Servos>) -> Settings {
    while let Err(error) = Controller::new(Arc::clone(model), settings.clone(), servos.cloned()) {
        let text = error.to_string();
        if text.contains("stiffness") || text.contains("axes.damping") {
            for axis in &mut settings.axes {
                axis.stiffness = axis.stiffness.map(|pair| pair.map(|k| 0.7 * k));
                axis.damping = axis.damping.map(|pair| pair.map(|d| 0.7 * d));
            }
            settings.null_space.stiffness = settings.null_space.stiffness.map(|k| 0.7 * k);
        } else {
            assert!(text.contains("cannot move"), "{text}");
            settings.tracking.damping = Damping::Fixed(0.3);
        }
    }
    settings
}

/// Returns true if these settings do not need `k_p`.
pub(crate) fn works_without_kp(settings: &Settings) -> bool {
    settings.law == Law::Paper
        && settings.effective_follow() == Follow::Hold
        && !settings.paper_options.budget_on_goal
        && matches!(settings.gravity_use(), GravityUse::Off | GravityUse::Limits)
}

/// Returns random servos around `nominal`, some of them with a PWM limit.
pub(crate) fn servos(random: &mut Random, nominal: &Servos, n: usize) -> Servos {
    let mut servos = nominal.for_joints(n).unwrap();
    let first_kp = servos.kp[0];
    for i in 0..n {
        servos.kp[i] *= random.between(0.7, 1.3);
        servos.max_torque[i] *= random.between(0.4, 1.2);
        servos.friction[i] *= random.between(0.0, 1.5);
        if random.chance(0.3) {
            servos.load_friction[i] = random.between(0.0, 0.3);
            servos.stribeck[i] = random.between(0.0, 0.2);
            servos.load_stribeck[i] = random.between(0.0, 0.3);
            servos.stribeck_speed[i] = random.between(0.3, 3.0);
        }
        servos.encoder_step[i] = random.pick(&[0.0, 1e-3, 5e-3]);
    }
    // True for half of the servos, without a random number: the other values of a seed stay as they are.
    servos.stiffness_known = servos.kp[0] > first_kp;
    if random.chance(0.3) {
        servos.limit_type = pliant_core::LimitType::Pwm;
        servos.no_load_speed = Some((0..n).map(|_| random.between(4.0, 10.0)).collect());
    }
    servos
}
