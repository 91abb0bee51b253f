//! Tests of defaults derived from the arm, of rejected settings, and of the estimated smallest singular value.

use std::sync::Arc;

use nalgebra::DMatrix;
use pliant_core::params::{
    Axis, AxisImpedance, AxisStrength, CompliantSide, Damping, DampingParams, Gain, Law, NullSpace, PaperOptions, Task,
    Tracking,
};
use pliant_core::{Controller, Error, Model, ModelOptions, Payload, Reference, Servos, Settings, StepInput};

use crate::seeded::{self, Random};

fn arm(index: usize) -> (Arc<Model>, Servos) {
    (seeded::arm(index, &ModelOptions::default()), seeded::servos(index))
}

fn controller(settings: Settings) -> Result<Controller, Error> {
    let (model, servos) = arm(0);
    Controller::new(model, settings, Some(servos))
}

fn refusal(settings: Settings, servos: Servos) -> String {
    let (model, _) = arm(0);
    Controller::new(model, settings, Some(servos)).unwrap_err().to_string()
}

fn yielding(axes: &str, axis: Axis) -> Settings {
    let mut settings = Settings::default();
    settings.set_axes(axes, axis).unwrap();
    settings
}

/// Returns the Halton point `index` over the joint ranges, computed independently of the crate.
fn halton(model: &Model, index: u32) -> Vec<f64> {
    let digit_sum = |mut i: u32, base: u32| {
        let (mut value, mut place) = (0.0, 1.0 / f64::from(base));
        while i > 0 {
            value += f64::from(i % base) * place;
            place /= f64::from(base);
            i /= base;
        }
        value
    };
    [2, 3, 5, 7, 11, 13, 17]
        .into_iter()
        .take(model.n())
        .enumerate()
        .map(|(i, base)| model.lower()[i] + digit_sum(index, base) * (model.upper()[i] - model.lower()[i]))
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}

fn smallest(model: &Model, q: &[f64], axes: &[usize], length: f64) -> f64 {
    let jacobian = model.jacobian(q, Reference::WorldAligned).unwrap();
    DMatrix::from_fn(axes.len(), model.n(), |r, i| jacobian[(axes[r], i)] / if axes[r] < 3 { length } else { 1.0 })
        .singular_values()
        .min()
}

#[test]
fn stiffness_is_rejected_if_half_of_the_poses_would_oscillate() {
    let (_, servos) = arm(0);
    let delayed = |stiffness: f64| {
        let mut settings = Settings { law: Law::Impedance, delay: 0.02, ..Settings::default() };
        settings.set_axes("x z", Axis { stiffness: Some([stiffness, 0.0]), ..Axis::default() }).unwrap();
        settings
    };
    let message = refusal(delayed(2000.0), servos.clone());
    assert!(
        message.starts_with("axes.stiffness: x=2000 N/m, z=2000 N/m is ")
            && message.contains(" times the bound for the median pose")
            && message.contains(": use x=")
            && message.contains("accept_high_stiffness=True"),
        "{message}"
    );
    // The value that the message proposes is accepted; a tenth more is not.
    let nearest: f64 = message.split("use x=").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    controller(delayed(nearest)).unwrap();
    assert!(controller(delayed(1.1 * nearest)).is_err());
    controller(Settings { accept_high_stiffness: true, ..delayed(2000.0) }).unwrap();
    // Default springs are not rejected but scaled down in each step.
    let defaults = Settings { law: Law::Impedance, delay: 0.02, rate: 50.0, ..Settings::default() };
    let mut running = controller(defaults.clone()).unwrap();
    assert_eq!(running.axis_impedances()[0], AxisImpedance { stiffness: [800.0; 2], damping: [0.0; 2] });
    assert_eq!(running.axis_impedances()[5], AxisImpedance { stiffness: [20.0; 2], damping: [0.0; 2] });
    let q = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
    let tool = arm(0).0.forward_kinematics(&q).unwrap();
    running.step(&q, &tool, &StepInput::default()).unwrap();
    assert!((running.gain_factor() - 1.0 / 2.7).abs() < 0.02, "{}", running.gain_factor());
    let message = refusal(
        Settings { null_space: NullSpace { stiffness: Some(100.0), ..defaults.null_space }, ..defaults },
        servos.clone(),
    );
    assert!(message.starts_with("null_space.stiffness [N·m/rad] = 100 is outside [0, 60.000]"), "{message}");
    let mut damped = Settings { law: Law::Impedance, delay: 0.02, ..Settings::default() };
    for (stiffness, accepted) in [(40.0, true), (60.0, false)] {
        damped.set_axes("xyz", Axis { damping: Some([stiffness; 2]), ..Axis::default() }).unwrap();
        damped.set_axes("rpy", Axis { damping: Some([0.0375 * stiffness; 2]), ..Axis::default() }).unwrap();
        assert_eq!(controller(damped.clone()).is_ok(), accepted, "{stiffness}");
    }
    let message = refusal(damped, servos.clone());
    let given = "x=60 N·s/m, y=60 N·s/m, z=60 N·s/m, roll=2.25 N·m·s/rad, pitch=2.25 N·m·s/rad, yaw=2.25 N·m·s/rad";
    assert!(message.starts_with(&format!("axes.damping: {given} is 1.")), "{message}");
    // The side of an axis that yields has no spring by default.
    let mut soft = Settings { law: Law::Impedance, ..Settings::default() };
    soft.set_axes("y", Axis { yields: Some(CompliantSide::Plus), ..Axis::default() }).unwrap();
    assert_eq!(
        controller(soft).unwrap().axis_impedances()[1],
        AxisImpedance { stiffness: [800.0, 0.0], damping: [0.0; 2] }
    );
}

#[test]
fn springs_are_rejected_under_other_laws() {
    let (_, servos) = arm(0);
    let message = |settings: Settings| refusal(settings, servos.clone());
    let text = message(yielding("y", Axis { stiffness: Some([100.0; 2]), ..Axis::default() }));
    assert!(text.starts_with("axes.y.stiffness: belongs to law=\"impedance\""), "{text}");
    let text = message(yielding("yaw", Axis { damping: Some([1.0; 2]), ..Axis::default() }));
    assert!(text.starts_with("axes.yaw.damping: belongs to law=\"impedance\""), "{text}");
    assert!(
        message(Settings {
            null_space: NullSpace { stiffness: Some(1.0), ..NullSpace::default() },
            ..Settings::default()
        })
        .starts_with("null_space.stiffness: belongs")
    );
    let hold = Settings {
        law: Law::Impedance,
        paper_options: PaperOptions { follow: Some(pliant_core::params::Follow::Hold), ..PaperOptions::default() },
        ..Settings::default()
    };
    assert!(message(hold).starts_with("paper_options.follow: law=\"impedance\" has no inverse kinematics"));
    let text = Controller::new(arm(0).0, Settings { law: Law::Impedance, ..Settings::default() }, None).unwrap_err();
    assert!(text.to_string().contains("law=\"impedance\" needs the stiffness k_p"), "{text}");
}

#[test]
fn arm7_has_its_documented_defaults() {
    let controller = controller(Settings::default()).unwrap();
    for (axis, AxisStrength { soft, firm, hold }) in controller.axis_strengths().into_iter().enumerate() {
        let expected = if axis < 3 { [4.0, 15.0, 40.0] } else { [0.8, 1.5, 4.0] };
        for (value, expected) in
            [(soft[0], expected[0]), (soft[1], expected[0]), (firm[0], expected[1]), (hold, expected[2])]
        {
            assert!((value - expected).abs() < 1e-12, "axis {axis}: {soft:?} {firm:?} {hold}");
        }
    }
    let DampingParams { lambda_0, sigma_0, lambda_max } = controller.singularity_damping();
    assert!((sigma_0 - 0.15).abs() < 0.005 && (lambda_0 - 0.02).abs() < 0.001, "{lambda_0} {sigma_0}");
    assert!((lambda_max - sigma_0).abs() < 1e-15 && (lambda_0 - 0.13 * sigma_0).abs() < 0.005 * sigma_0);
}

#[test]
fn damping_is_twice_the_median_over_512_poses() {
    for (index, axes) in [(0, "all"), (1, "xyz"), (2, "xyz"), (0, "x z pitch"), (2, "xyz pitch roll")] {
        let (model, servos) = arm(index);
        let task = Task::parse(axes).unwrap();
        let chosen: Vec<usize> = (0..6).filter(|&a| task.axes[a]).collect();
        let controller =
            Controller::new(Arc::clone(&model), Settings { task, ..Settings::default() }, Some(servos)).unwrap();
        let length = model.reach() / 0.71;
        let sigma = median((1..=512).map(|i| smallest(&model, &halton(&model, i), &chosen, length)).collect());
        // σ₀ is twice the median, rounded to two digits.
        let (sigma_0, exact) = (controller.singularity_damping().sigma_0, 2.0 * sigma);
        let digit = 10.0_f64.powf(exact.log10().floor() - 1.0);
        assert!((sigma_0 - exact).abs() <= 0.5 * digit + 1e-9, "{axes}: {sigma_0} {exact}");
        assert!((sigma_0 / digit - (sigma_0 / digit).round()).abs() < 1e-6, "{axes}: {sigma_0}");
    }
}

#[test]
fn default_strengths_scale_with_the_arm() {
    let (model, servos) = arm(2);
    let settings = Settings { task: Task::parse("xyz").unwrap(), ..Settings::default() };
    let controller = Controller::new(model, settings, Some(servos)).unwrap();
    let AxisStrength { soft, firm, hold } = controller.axis_strengths()[0];
    for (value, low, high) in [(soft[0], 0.5, 1.5), (firm[0], 2.0, 5.0), (hold, 6.0, 13.0)] {
        assert!(value >= low && value <= high, "{soft:?} {firm:?} {hold}");
    }
}

#[test]
fn a_payload_in_grams_is_named_with_the_joints_that_it_overloads() {
    let make = |mass| {
        let payload = Some(Payload { mass, com: [0.0; 3] });
        let model = seeded::arm(2, &ModelOptions { payload, ..ModelOptions::default() });
        let settings = Settings { task: Task::parse("xyz").unwrap(), ..Settings::default() };
        Controller::new(model, settings, Some(seeded::servos(2)))
    };
    make(0.1).unwrap();
    let message = make(250.0).unwrap_err().to_string();
    for part in [
        "axes.x: no default strength",
        "; shoulder_lift needs up to 1003.116 N·m, its servo has 1.900 N·m",
        "of the payload (250 kg)",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

#[test]
fn eta_above_095_requires_known_k_p_captured_gravity_or_consent() {
    let bold = || yielding("y", Axis { soft: Some([2.0; 2]), adaptation: 0.96, ..Axis::default() });
    let unsure = Servos { stiffness_known: false, ..seeded::servos(0) };
    let message = refusal(bold(), unsure.clone());
    assert!(
        message.starts_with("axes.y.adaptation = 0.96 is outside") && message.contains("accept_high_adaptation"),
        "{message}"
    );
    controller(bold()).unwrap();
    let make = |settings: Settings| Controller::new(arm(0).0, settings, Some(unsure.clone()));
    make(Settings { accept_high_adaptation: true, ..bold() }).unwrap();
    make(yielding("y", Axis { soft: Some([2.0; 2]), adaptation: 0.95, ..Axis::default() })).unwrap();
    let paper = |settings: Settings| Settings { law: Law::Paper, ..settings };
    make(paper(bold())).unwrap();
    // Once the gravity offset has been captured, settings that require it are accepted.
    let mut running = make(Settings::default()).unwrap();
    assert!(running.update(bold()).is_err());
    let q = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
    running.capture_gravity(&q, &q.map(|x| x - 0.01)).unwrap();
    running.update(bold()).unwrap();
}

#[test]
fn the_gain_is_bounded_by_the_delay() {
    let with = |kx: Gain, delay: f64, rate: f64| {
        controller(Settings {
            delay,
            rate,
            tracking: Tracking { gain: kx, ..Tracking::default() },
            ..Settings::default()
        })
    };
    // Bound: K_x h ≤ max(1, min(3, 0.03 s / (T_d + half a period))).
    with(Gain::Scalar(12.0), 0.0, 100.0).unwrap();
    assert!(with(Gain::Scalar(12.1), 0.0, 100.0).is_err());
    with(Gain::Scalar(4.0), 0.1, 100.0).unwrap();
    assert!(with(Gain::Scalar(4.1), 0.1, 100.0).is_err());
    with(Gain::Scalar(7.9), 0.01, 100.0).unwrap();
    assert!(with(Gain::Scalar(8.1), 0.01, 100.0).is_err());
    // The bound limits the gain in every direction, not only along the axes.
    let pair = |off: f64| {
        let mut m = vec![vec![0.0; 6]; 6];
        (0..6).for_each(|i| m[i][i] = 4.0);
        (m[0][1], m[1][0]) = (off, off);
        Gain::Matrix(m)
    };
    with(pair(3.9), 0.01, 100.0).unwrap();
    assert!(with(pair(4.1), 0.01, 100.0).is_err());
    // Servos with high damping allow a higher gain.
    let (model, servos) = arm(2);
    let stiff = Settings {
        task: Task::parse("xyz").unwrap(),
        delay: 0.02,
        tracking: Tracking { gain: Gain::Scalar(12.0), ..Tracking::default() },
        ..Settings::default()
    };
    Controller::new(model, stiff, Some(servos)).unwrap();
    // A measured delay reduces the gain instead of raising an error.
    let mut running = with(Gain::Scalar(8.0), 0.0, 100.0).unwrap();
    running.set_delay(0.025).unwrap();
    assert!((running.gain_factor() - 0.5).abs() < 1e-12);
    running
        .update(Settings {
            tracking: Tracking { gain: Gain::Scalar(6.0), ..Tracking::default() },
            ..Settings::default()
        })
        .unwrap();
    assert!((running.gain_factor() - 4.0 / 6.0).abs() < 1e-12, "an update keeps the measured delay");
    running.set_delay(0.0).unwrap();
    assert!((running.gain_factor() - 1.0).abs() < 1e-12);
}

#[test]
fn more_axes_than_joints_require_a_length_that_weights_them() {
    let (model, servos) = arm(2);
    let make = |length, damping| {
        let task = Task { length, ..Task::default() };
        let settings = Settings {
            task,
            max_tool_speed: [f64::INFINITY; 2],
            tracking: Tracking { damping, goal_slew: f64::INFINITY, ..Tracking::default() },
            ..Settings::default()
        };
        Controller::new(Arc::clone(&model), settings, Some(servos.clone()))
    };
    let message = make(None, Damping::Auto).unwrap_err().to_string();
    assert!(message.contains("task.length"), "{message}");
    let q = [0.2, -0.3, 0.3, 0.9, 0.1];
    let target = {
        let mut pose = model.forward_kinematics(&q).unwrap();
        pose.position[1] += 0.02;
        pose
    };
    for damping in [Damping::Auto, Damping::Fixed(0.02)] {
        // With a larger length, translations have less weight, so the position error is larger.
        let position_error = |length: f64| {
            let mut controller = make(Some(length), damping).unwrap();
            let command = *controller.step(&q, &target, &StepInput::default()).unwrap();
            assert!(controller.sigma_range()[0] > 1e-3, "the smallest of the five");
            let rows = controller.task_jacobian();
            let gravity = controller.diagnostics().gravity;
            let lead: Vec<f64> = (0..5).map(|i| command.goal()[i] - q[i] - gravity[i] / 5.1).collect();
            (0.02 - (0..5).map(|i| rows[(1, i)] * lead[i]).sum::<f64>()).abs()
        };
        let (near, far) = (position_error(0.1), position_error(1.0));
        assert!(near < 0.7 * far, "{damping:?}: {near} {far}");
    }
}

#[test]
fn axes_that_an_arm_cannot_move_independently_are_rejected() {
    let (model, servos) = arm(2);
    let settings = Settings { task: Task::parse("xyz pitch yaw").unwrap(), ..Settings::default() };
    match Controller::new(model, settings, Some(servos)) {
        Ok(controller) => assert!(controller.singularity_damping().sigma_0 > 1e-6),
        Err(error) => assert!(error.to_string().contains("cannot move"), "{error}"),
    }
}

#[test]
fn laws_with_forces_require_k_p() {
    let (model, _) = arm(0);
    let message = Controller::new(Arc::clone(&model), Settings::default(), None).unwrap_err().to_string();
    assert!(message.contains("shoulder_pitch") && message.contains("Servos("), "{message}");
    let mut paper = Settings { law: Law::Paper, gravity: false, ..Settings::default() };
    paper.set_axes("y", Axis { yields: Some(CompliantSide::Both), ..Axis::default() }).unwrap();
    Controller::new(model, paper, None).unwrap();
}

/// Returns the largest relative and the largest absolute error of the estimate against the SVD along a path.
fn worst_estimate(index: usize, axes: &str, path: impl Fn(f64) -> Vec<f64>, ticks: usize) -> (f64, f64) {
    let (model, servos) = arm(index);
    let settings = Settings { task: Task::parse(axes).unwrap(), ..Settings::default() };
    let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
    let sigma_0 = controller.singularity_damping().sigma_0;
    let target = model.forward_kinematics(&path(0.0)).unwrap();
    let (mut relative, mut absolute): (f64, f64) = (0.0, 0.0);
    for tick in 0..=ticks {
        let q = path(tick as f64 / ticks as f64);
        controller.step(&q, &target, &StepInput::default()).unwrap();
        if controller.diagnostics().locked.contains(&true) {
            continue;
        }
        let (got, want) = (controller.sigma_range()[0], controller.singular_values().min());
        if want > 0.1 * sigma_0 {
            relative = relative.max((got - want).abs() / want);
        }
        absolute = absolute.max((got - want).abs() / sigma_0);
    }
    (relative, absolute)
}

#[test]
fn sigma_tracks_smooth_motions() {
    let mut random = Random::new(11);
    let (mut worst, mut errors) = ((0.0_f64, 0.0_f64), Vec::new());
    for round in 0..60 {
        let index = round % 3;
        let (model, _) = arm(index);
        let (from, to) = (random.joints(&model, 0.95), random.joints(&model, 0.95));
        // The path between two arbitrary postures takes 1.5 s, with joint speeds up to 3 rad/s.
        let path = |t: f64| (0..model.n()).map(|i| from[i] + (to[i] - from[i]) * t).collect();
        let (relative, absolute) = worst_estimate(index, if index == 2 { "xyz" } else { "all" }, path, 150);
        worst = (worst.0.max(relative), worst.1.max(absolute));
        errors.push(relative);
    }
    assert!(median(errors.clone()) < 1e-3, "{errors:?}");
    assert!(worst.0 < 0.01 && worst.1 < 0.01, "{worst:?}");
}

#[test]
fn sigma_is_exact_right_after_a_reset() {
    let mut random = Random::new(12);
    for round in 0..150 {
        let index = round % 3;
        let (model, servos) = arm(index);
        let q = random.joints(&model, 0.9);
        let settings = Settings { task: Task::parse("xyz").unwrap(), ..Settings::default() };
        let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
        controller.reset(&q).unwrap();
        controller.step(&q, &model.forward_kinematics(&q).unwrap(), &StepInput::default()).unwrap();
        let (got, want) = (controller.sigma_range()[0], controller.singular_values().min());
        assert!((got - want).abs() < 0.01 * want, "{got} {want}");
    }
}

#[test]
fn sigma_finds_both_blocks_of_a_planar_arm() {
    // With all roll and yaw joints at 0, `JJᵀ` has two blocks. Iteration from a vector in one block never reaches the
    // other.
    for (from, to) in [(-1.9, -0.02), (-0.02, -1.9)] {
        for wrist in [0.0, 0.7, 1.5] {
            let path = |t: f64| vec![0.2, 0.0, 0.0, from + (to - from) * t, 0.0, wrist * t, 0.0];
            let (relative, absolute) = worst_estimate(0, "all", path, 400);
            assert!(relative < 0.01 && absolute < 0.01, "{from}: {relative} {absolute}");
        }
    }
}
