//! Tests of the pose report (forces compared with a search, signs) and of the proposals of a feasibility check.

use std::sync::Arc;

use pliant_core::analysis::{check_path, check_pose, raise_soft, report, report_at};
use pliant_core::params::{
    Axis, CompliantSide, Damping, Frame, Gain, Law, LimitRule, PaperOptions, Task, TorqueLimits, Tracking,
};
use pliant_core::{Controller, Model, ModelOptions, Payload, Reference, Servos, Settings, StepInput};

use crate::common;

const GRASP: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];

fn servos() -> Servos {
    let each = |arm: f64, wrist: f64| vec![arm, arm, arm, arm, wrist, wrist, wrist];
    Servos {
        friction: each(0.2, 0.1),
        damping: each(1.2, 0.8),
        stiffness_known: true,
        ..Servos::new(each(150.0, 60.0), each(10.7, 6.4))
    }
}

fn arm() -> Arc<Model> {
    Arc::new(common::arm7())
}

fn controller(settings: Settings) -> Controller {
    Controller::new(arm(), settings, Some(servos())).unwrap()
}

fn soft(axes: &str, soft: f64, firm: f64) -> Settings {
    let mut settings = Settings::default();
    settings.set_axes(axes, Axis { soft: Some([soft; 2]), firm: Some([firm; 2]), ..Axis::default() }).unwrap();
    settings
}

/// Returns the largest force F ≥ 0 along an axis at which torques within the limits balance gravity and the push, by
/// bisection.
fn bisected_force(model: &Model, q: &[f64], limit: &[f64], axis: usize, sign: f64) -> f64 {
    let (jacobian, gravity) = (model.jacobian(q, Reference::WorldAligned).unwrap(), model.gravity(q).unwrap());
    let holds = |force: f64| {
        (0..model.n()).all(|i| (gravity[i] - sign * force * jacobian[(axis, i)]).abs() <= limit[i] * (1.0 + 1e-12))
    };
    assert!(holds(0.0));
    let (mut low, mut high) = (0.0, 1e5);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if holds(middle) { low = middle } else { high = middle }
    }
    low
}

#[test]
fn static_force_and_capacity_agree_with_a_search() {
    for settings in [
        soft("y yaw", 4.0, 15.0),
        Settings {
            paper_options: PaperOptions { limits: LimitRule::Sum, ..soft("y", 4.0, 15.0).paper_options },
            ..soft("y", 4.0, 15.0)
        },
    ] {
        let controller = controller(settings);
        let torque = servos().max_torque;
        for seed in 0..60 {
            let q = common::state(controller.model(), seed);
            let report = report_at(&controller, &q).unwrap();
            for axis in 0..6 {
                for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
                    for (reported, limit) in [
                        (report.axes[axis].static_force[side], &report.torque_limit),
                        (report.axes[axis].capacity[side], &torque),
                    ] {
                        let found = bisected_force(controller.model(), &q, limit, axis, sign);
                        common::close("force", reported, found, 1e-6 * (1.0 + found));
                    }
                    assert!(report.axes[axis].capacity[side] >= report.axes[axis].static_force[side]);
                    assert!(report.axes[axis].yield_force[side][1] <= report.axes[axis].capacity[side] + 1e-12);
                }
            }
        }
    }
}

/// Returns a controller of one joint about z, with the tool at 0.5 m. The servo has 100 N·m/rad, 0.2 N·m of friction
/// and 0.5 N·m·s/rad of damping; the task is y.
fn lever(settings: Settings) -> Controller {
    let urdf = r#"<robot name="lever"><link name="base"/><link name="tool"><inertial><mass value="0.1"/>
        <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
        <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" effort="8" velocity="3"/></joint>
        <link name="arm"><inertial><mass value="0.1"/>
        <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
        <joint name="out" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="0.5 0 0"/></joint></robot>"#;
    let model = Arc::new(Model::from_urdf_str(urdf, &ModelOptions::default()).unwrap());
    let servos = Servos { friction: vec![0.2], damping: vec![0.5], ..Servos::new(vec![100.0], vec![8.0]) };
    let settings = Settings { task: Task::parse("y").unwrap(), ..settings };
    Controller::new(model, settings, Some(servos)).unwrap()
}

/// Returns the force along y [N] at which the joint of `lever` slips with this torque limit [N·m], with the tool at `y`
/// [m].
fn slip_force(limit: f64, y: f64) -> f64 {
    let lever = (0.25 - y * y).sqrt();
    (limit + 0.2) / lever + 0.5 * 0.025 / (lever * lever)
}

/// The joint slips at torque limit plus friction. The lever of a push along y decreases along the path.
#[test]
fn after_a_host_loss_a_joint_slips_at_its_limit() {
    let report = report_at(&lever(Settings::default()), &[0.0]).unwrap();
    let expected = slip_force(report.torque_limit[0], 0.15);
    for side in 0..2 {
        common::close("host-loss force", report.axes[0].host_loss_force[side], expected, 0.02 * expected);
    }
}

/// A hand holds the arm at 0 rad with its goal ahead, and releases it at the host loss. The push starts where friction
/// then stops the joint.
#[test]
fn after_a_host_loss_the_push_starts_at_the_equilibrium() {
    let mut controller = lever(Settings::default());
    let target = controller.model().forward_kinematics(&[0.25]).unwrap();
    for _ in 0..200 {
        controller.step(&[0.0], &target, &StepInput::default()).unwrap();
    }
    let (goal, report) = (controller.last_command().unwrap().goal()[0], report(&controller).unwrap());
    let rest = 0.5 * (goal - 0.2 / 100.0).sin();
    assert!(goal > 0.04 && rest > 0.02);
    let expected = slip_force(report.torque_limit[0], rest + 0.15);
    common::close("host-loss force", report.axes[0].host_loss_force[1], expected, 0.01 * expected);
    assert!(slip_force(report.torque_limit[0], 0.15) < 0.98 * expected, "a push from 0 rad would need less force");
}

/// The bound on the force after a host loss lowers the torque limits by as much as it needs, down to their floor.
#[test]
fn torque_limits_bound_the_force_after_a_host_loss() {
    let bounded = |max: Option<f64>| {
        let floor = Some(vec![0.3]);
        let torque_limits = TorqueLimits { floor, margin: 0.4, max_host_loss_force: max, ..TorqueLimits::default() };
        let report = report_at(&lever(Settings { torque_limits, ..Settings::default() }), &[0.0]).unwrap();
        let force = report.axes[0].host_loss_force.into_iter().fold(0.0, f64::max);
        (force, report.torque_limit[0])
    };
    let (free, limit) = bounded(None);
    for share in [0.95, 0.7, 0.4] {
        let (force, lower) = bounded(Some(share * free));
        assert!(force <= share * free && force > (share - 0.05) * free, "{share} of {free}: {force}");
        assert!(lower < limit, "{lower} {limit}");
    }
    // Gravity along y makes the push against it the stronger one, on either side.
    for gravity in [-9.81, 9.81] {
        let worst = |max: Option<f64>| {
            let torque_limits = TorqueLimits { max_host_loss_force: max, ..TorqueLimits::default() };
            let mut controller = lever(Settings { torque_limits, ..Settings::default() });
            controller.set_gravity([0.0, gravity, 0.0]).unwrap();
            report_at(&controller, &[0.0]).unwrap().axes[0].host_loss_force
        };
        let side = usize::from(gravity < 0.0);
        let free = worst(None);
        assert!(free[side] > 1.05 * free[1 - side], "{free:?}");
        let force = worst(Some(0.97 * free[side]))[side];
        assert!(force <= 0.97 * free[side] && force > 0.9 * free[side], "{force} {free:?}");
    }
    let at_floor = bounded(Some(0.01));
    common::close("floor", at_floor.1, 0.3, 1e-12);
    assert_eq!(bounded(Some(1.01 * free)), (free, limit));
}

/// Only translations are bounded: a task of rotations keeps its torque limits.
#[test]
fn the_bound_after_a_host_loss_is_for_translations() {
    let limits = |axes: &str, max: Option<f64>| {
        let torque_limits = TorqueLimits { max_host_loss_force: max, ..TorqueLimits::default() };
        let settings = Settings { task: Task::parse(axes).unwrap(), torque_limits, ..Settings::default() };
        report_at(&controller(settings), &GRASP).unwrap().torque_limit
    };
    assert_eq!(limits("rpy", Some(0.01)), limits("rpy", None));
    assert_ne!(limits("z", Some(0.01)), limits("z", None));
}

/// The limits of all joints lose the same share of their margin, a tenth of the usable torque, if that is enough. The
/// arm pushes against an obstacle, so that its limits exceed those for its weight by more than the margin.
#[test]
fn a_bound_after_a_host_loss_first_takes_the_same_share_of_each_margin() {
    let at = |max: Option<f64>| {
        let torque_limits = TorqueLimits { max_host_loss_force: max, ..TorqueLimits::default() };
        let mut pushing = controller(Settings { torque_limits, ..Settings::default() });
        let mut target = pushing.model().forward_kinematics(&GRASP).unwrap();
        target.position.iter_mut().for_each(|value| *value += 0.02);
        for _ in 0..100 {
            pushing.step(&GRASP, &target, &StepInput::default()).unwrap();
        }
        let report = report(&pushing).unwrap();
        let force = report.axes[..3].iter().flat_map(|axis| axis.host_loss_force).filter(|force| force.is_finite());
        (force.fold(0.0, f64::max), report.torque_limit)
    };
    let (force, free) = at(None);
    let (_, bounded) = at(Some(0.98 * force));
    let shares: Vec<f64> = (0..7).map(|i| (free[i] - bounded[i]) / (0.1 * servos().max_torque[i])).collect();
    assert!(shares[0] > 0.1 && shares[0] < 1.0, "{shares:?}");
    for share in &shares[1..] {
        common::close("share", *share, shares[0], 1e-9);
    }
}

/// At small deviations ẽ the force caps have no effect. With lever l, damping λ and softness w, law `cap` then exerts
/// `s / (C + (1 − w) λ²/k_p)`, where `C = l²/k_p` and the step `s = h K_x ẽ` is limited. Law `impedance` exerts `f K ẽ`
/// with the stiffness K of the pushed side and the gain factor f.
#[test]
fn yield_forces_below_the_caps_are_those_of_the_law() {
    let (compliance, horizon, lambda) = (0.25 / 100.0, 0.3, 0.1);
    let forces = |law: Law, yields: CompliantSide, axis: Axis| {
        let (gain, damping) = (Gain::Scalar(2.0), Damping::Fixed(lambda));
        let mut settings =
            Settings { law, tracking: Tracking { gain, damping, ..Tracking::default() }, ..Settings::default() };
        settings.paper_options.horizon = horizon;
        settings.delay = 0.1;
        let (soft_until, firm_from) = (Some(1e-3), Some(2e-3));
        settings.axes[1] = Axis { yields: Some(yields), hold: Some(9.0), soft_until, firm_from, ..axis };
        let report = report_at(&lever(settings), &[0.0]).unwrap();
        (report.axes[0].yield_force, report.gain_factor)
    };
    let strong = Axis { soft: Some([9.0; 2]), firm: Some([9.0; 2]), adaptation: 0.5, ..Axis::default() };
    let springs = Axis { stiffness: Some([200.0, 300.0]), ..strong };
    let slow = Axis { soft_step_limit: Some(2e-3), ..strong };
    let stiff = Axis { max_velocity: Some(3e-3), ..Axis::default() };
    let (soft, damped) = (compliance, compliance + lambda * lambda / 100.0);
    for (law, yields, axis, stiffness, limit) in [
        (Law::Cap, CompliantSide::Both, strong, [horizon * 2.0 / soft; 2], f64::INFINITY),
        (Law::Cap, CompliantSide::Both, slow, [horizon * 2.0 / soft; 2], horizon * 2e-3 / soft),
        (Law::Cap, CompliantSide::None, Axis::default(), [horizon * 2.0 / damped; 2], f64::INFINITY),
        (Law::Cap, CompliantSide::None, stiff, [horizon * 2.0 / damped; 2], horizon * 3e-3 / damped),
        (Law::Impedance, CompliantSide::Both, springs, [200.0, 300.0], f64::INFINITY),
    ] {
        let (forces, gain_factor) = forces(law, yields, axis);
        for side in 0..2 {
            for (force, deviation) in forces[side].into_iter().zip([1e-3, 2e-3]) {
                let expected = (stiffness[side] * gain_factor * deviation).min(limit);
                common::close("yield force", force, expected, 1e-9);
            }
        }
    }
}

/// The damping ratio `ρ = D C` of the lever is bounded by 0.007 s² / (T_e + T_f) with `T_e = T_d + 1 / (2 rate)`.
#[test]
fn the_report_gives_the_reduction_of_dampers() {
    let factor = |damping: [f64; 2]| {
        let mut settings = Settings { law: Law::Impedance, rate: 50.0, delay: 0.02, ..Settings::default() };
        settings.axes[1] = Axis { damping: Some(damping), ..Axis::default() };
        let filter = settings.tracking.velocity_filter;
        let bound = 0.007 / (0.02 + 0.01 + filter);
        (report_at(&lever(settings), &[0.0]).unwrap().damping_factor, bound / (0.0025 * damping[0].max(damping[1])))
    };
    for damping in [[50.0, 90.0], [90.0, 10.0]] {
        let (factor, expected) = factor(damping);
        assert!(expected < 0.95, "{expected}");
        common::close("damping factor", factor, expected, 1e-9);
    }
    common::close("weak damper", factor([5.0, 5.0]).0, 1.0, 1e-15);
    common::close("no damper", report_at(&lever(Settings::default()), &[0.0]).unwrap().damping_factor, 1.0, 1e-15);
}

/// A push beyond the reach of the arm stretches it: at its dead centre the joint no longer follows.
#[test]
fn a_push_that_stretches_the_arm_is_blocked() {
    let forces = |q: f64| report_at(&lever(Settings::default()), &[q]).unwrap().axes[0].host_loss_force;
    // The tool is at y = ±0.48 m of at most 0.5 m.
    let [[minus, plus], [other_minus, other_plus]] = [forces(1.3), forces(-1.3)];
    assert!(plus.is_infinite() && other_minus.is_infinite(), "{plus} {other_minus}");
    assert!(minus > 0.0 && minus.is_finite() && (minus - other_plus).abs() < 1e-9, "{minus} {other_plus}");
    // Beyond the dead centre, at y = 0.473 m, a push toward 0 drives the joint to its limit of 2 rad, where y = 0.455 m.
    for force in [forces(1.9), forces(-1.9)].concat() {
        assert!(force.is_infinite(), "{force}");
    }
    // A push of 0.15 m that ends before both is not blocked.
    assert!(forces(0.75).iter().all(|force| force.is_finite()));
}

/// Two springs of 50 and 100 N/m in series along y, with 1 and 3 N of friction, that do not slip: each stretches by
/// `(F − τ_f)/k` once the push exceeds its friction. Also with a thousandth of these numbers.
#[test]
fn dead_springs_in_series_share_the_push() {
    let inertial = r#"<inertial><mass value="0.1"/>
        <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial>"#;
    let joint = |parent: &str, child: &str| {
        format!(
            r#"<joint name="{parent}_{child}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>
            <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="400" velocity="1"/></joint>"#
        )
    };
    let urdf = format!(
        r#"<robot name="slides"><link name="base"/><link name="carriage">{inertial}</link>
        <link name="tool">{inertial}</link>{}{}</robot>"#,
        joint("base", "carriage"),
        joint("carriage", "tool")
    );
    let options = ModelOptions { gravity: [0.0; 3], ..ModelOptions::default() };
    let model = Arc::new(Model::from_urdf_str(&urdf, &options).unwrap());
    for scale in [1.0, 1e-3] {
        let servos = Servos {
            friction: vec![scale, 3.0 * scale],
            ..Servos::new(vec![50.0 * scale, 100.0 * scale], vec![400.0 * scale; 2])
        };
        let settings = Settings { task: Task::parse("y").unwrap(), ..Settings::default() };
        let report =
            report_at(&Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap(), &[0.0; 2]).unwrap();
        // The push of 0.15 m ends within two steps.
        let [least, most] = [0.15, 0.1561].map(|y| scale * (y + 1.0 / 50.0 + 3.0 / 100.0) / (1.0 / 50.0 + 1.0 / 100.0));
        assert!(report.torque_limit.iter().all(|limit| *limit > most), "no slip: {:?}", report.torque_limit);
        for force in report.axes[0].host_loss_force {
            assert!(force >= least - 1e-6 * scale && force <= most, "{least} {force} {most}");
        }
    }
}

#[test]
fn sides_are_named_by_the_push() {
    let report = report_at(&controller(soft("y", 4.0, 15.0)), &GRASP).unwrap();
    let axis = Axis { soft: Some([2.0, 4.0]), firm: Some([6.0, 8.0]), soft_until: Some(0.02), ..Axis::default() };
    let mut uneven = Settings::default();
    uneven.set_axes("y", axis).unwrap();
    let sided = report_at(&controller(uneven), &GRASP).unwrap();
    for (side, [small, large]) in [[2.0, 6.0], [4.0, 8.0]].into_iter().enumerate() {
        common::close("small", sided.axes[1].yield_force[side][0], small, 1e-12);
        common::close("large", sided.axes[1].yield_force[side][1], large, 1e-12);
    }
    // The arm is stretched forward, so gravity leaves less torque against a push down than against a push up.
    assert!(report.axes[2].capacity[0] < report.axes[2].capacity[1]);
    for i in 0..7 {
        let gravity = arm().gravity(&GRASP).unwrap()[i];
        common::close("L − g", report.gravity_margin[i][0], report.torque_limit[i] - gravity, 1e-12);
        common::close("L + g", report.gravity_margin[i][1], report.torque_limit[i] + gravity, 1e-12);
    }
    assert_eq!(report.axes.iter().map(|axis| axis.name).collect::<Vec<_>>(), ["x", "y", "z", "roll", "pitch", "yaw"]);
    assert!(report.axes[1].yields == [true, true] && report.axes[2].yields == [false, false]);
}

#[test]
fn target_adaptation_moves_the_thresholds_and_lowers_the_force_within_reach() {
    let mut settings = soft("y", 4.0, 15.0);
    settings.axes[1].adaptation = 0.9;
    let report = report_at(&controller(settings), &GRASP).unwrap();
    common::close("d−", report.axes[1].thresholds[0], 0.1, 1e-12);
    common::close("d+", report.axes[1].thresholds[1], 1.0, 1e-12);
    let plain = report_at(&controller(soft("y", 4.0, 15.0)), &GRASP).unwrap();
    assert!(report.axes[1].yield_force[1][1] < plain.axes[1].yield_force[1][1]);
}

#[test]
fn reports_of_the_last_step_and_at_rest_agree_and_change_nothing() {
    let mut one = controller(soft("y", 4.0, 15.0));
    assert!(report(&one).unwrap_err().to_string().contains("no step"));
    let mut two = one.clone();
    let target = one.model().forward_kinematics(&GRASP).unwrap();
    for _ in 0..3 {
        one.step(&GRASP, &target, &StepInput::default()).unwrap();
        two.step(&GRASP, &target, &StepInput::default()).unwrap();
        let _ =
            (report(&two).unwrap(), report_at(&two, &[0.1; 7]).unwrap(), check_path(&two, &[GRASP.to_vec()]).unwrap());
        assert_eq!(one.last_command(), two.last_command());
    }
    assert_eq!(report_at(&controller(soft("y", 4.0, 15.0)), &GRASP).unwrap().axes.len(), 6);
    let (now, rest) = (report(&one).unwrap(), report_at(&one, &GRASP).unwrap());
    for (a, b) in now.axes.iter().zip(&rest.axes) {
        for side in 0..2 {
            common::close("static force", a.static_force[side], b.static_force[side], 1e-9);
        }
    }
}

#[test]
fn the_report_says_that_an_arm_cannot_hold_itself() {
    let options = ModelOptions {
        payload: Some(Payload { mass: 3.0, com: [0.0; 3] }),
        tip: Some("tool".into()),
        ..ModelOptions::default()
    };
    let model = Arc::new(Model::from_urdf_file(common::root().join("tests/data/golden/arm7.urdf"), &options).unwrap());
    let controller = Controller::new(model, Settings::default(), Some(servos())).unwrap();
    let report = report_at(&controller, &GRASP).unwrap();
    assert!(report.axes[2].capacity[0] < 0.0 && report.axes[2].static_force[0] < 0.0);
    assert!(report.gravity_margin.iter().flatten().any(|margin| *margin < 0.0));
    assert!(report.summary().iter().any(|sentence| sentence.contains("cannot hold")));
    let check = check_path(&controller, &[GRASP.to_vec()]).unwrap();
    assert!(!check.achievable && check.issues[0].setting.is_none(), "{check}");
}

#[test]
fn the_check_proposes_gravity_for_law_paper() {
    let mut settings = Settings::paper();
    settings.set_axes("all", Axis { hold: Some(1.0), ..Axis::default() }).unwrap();
    let check = check_path(&controller(settings.clone()), &[GRASP.to_vec()]).unwrap();
    assert!(!check.achievable && check.issues.iter().any(|found| found.setting.as_deref() == Some("gravity")));
    settings.gravity = true;
    assert!(check_path(&controller(settings), &[GRASP.to_vec()]).unwrap().achievable);
}

#[test]
fn coupling_names_the_axis_that_shares_the_joints() {
    let mut settings = Settings::paper();
    settings.gravity = true;
    settings.set_axes("y", Axis { soft: Some([0.5; 2]), ..Axis::default() }).unwrap();
    let report = report_at(&controller(settings), &GRASP).unwrap();
    for side in 0..2 {
        assert!(
            report.axes[1].coupling[side] > 0.0 && report.axes[1].coupling[side] <= report.axes[1].yield_force[side][0]
        );
        assert!(report.axes[1].coupled_to[side].is_some());
    }
    assert!(report.summary().iter().any(|sentence| sentence.contains("is held")));
}

#[test]
fn values_proposed_by_a_check_work_and_larger_ones_do_not() {
    let path: Vec<Vec<f64>> = (0..20).map(|k| GRASP.iter().map(|q| q + 0.01 * f64::from(k)).collect()).collect();
    let mut settings = soft("y", 0.05, 60.0);
    settings.set_axes("z", Axis { hold: Some(90.0), ..Axis::default() }).unwrap();
    let mut check = check_path(&controller(settings.clone()), &path).unwrap();
    assert!(!check.achievable && check.poses == 20);
    for _ in 0..3 {
        for found in check.issues.iter().filter(|found| found.required) {
            let value = found.value.unwrap();
            match found.setting.as_deref().unwrap() {
                "axes.y.soft" => settings.axes[1].soft = Some([value; 2]),
                "axes.y.firm" => settings.axes[1].firm = Some([value.min(settings.axes[1].firm.unwrap()[0]); 2]),
                "axes.z.hold" => settings.axes[2].hold = Some(value.min(settings.axes[2].hold.unwrap())),
                other => panic!("{other}"),
            }
        }
        check = check_path(&controller(settings.clone()), &path).unwrap();
    }
    assert!(check.achievable, "{check}");
    settings.axes[2].hold = settings.axes[2].hold.map(|hold| 1.1 * hold);
    assert!(!check_path(&controller(settings), &path).unwrap().achievable);
}

#[test]
fn a_target_out_of_reach_is_not_achievable() {
    let controller = controller(Settings::default());
    let mut target = controller.model().forward_kinematics(&GRASP).unwrap();
    assert!(check_pose(&controller, &target, &GRASP).unwrap().achievable);
    target.position[0] += 1.0;
    let check = check_pose(&controller, &target, &GRASP).unwrap();
    assert!(!check.achievable && check.to_string().contains("out of reach"), "{check}");
    target.position[0] += 1.0;
    let error = check_pose(&controller, &target, &GRASP).unwrap_err();
    assert!(error.to_string().contains("millimetres?"), "{error}");
}

#[test]
fn tracking_raises_soft_to_three_times_the_friction_and_no_more() {
    let (model, servos, path) = (arm(), servos(), [GRASP.to_vec()]);
    let settings = soft("y", 0.01, 0.02);
    let raised = raise_soft(&settings, &model, Some(&servos), &path).unwrap();
    let friction = report_at(&controller(settings.clone()), &GRASP).unwrap().axes[1].friction;
    let [soft, _] = raised.axes[1].soft.unwrap();
    assert!(soft >= 3.0 * friction && soft < 3.3 * friction && raised.axes[1].firm.unwrap()[0] >= soft);
    let check = check_path(&Controller::new(arm(), raised.clone(), Some(servos.clone())).unwrap(), &path).unwrap();
    assert!(check.achievable, "{check}");
    // Settings whose `soft` is large enough do not change, neither on a path nor over the joint space.
    assert_eq!(raise_soft(&raised, &model, Some(&servos), &path).unwrap(), raised);
    let firm = self::soft("y", 9.0, 15.0);
    assert_eq!(raise_soft(&firm, &model, Some(&servos), &[]).unwrap(), firm);
}

#[test]
fn reports_support_fewer_axes_and_other_frames() {
    let mut settings = soft("y", 4.0, 15.0);
    settings.task = Task { frame: pliant_core::params::Frame::Tool, ..Task::parse("y z").unwrap() };
    let controller = controller(settings);
    for seed in 0..20 {
        let q = common::state(controller.model(), seed);
        let report = report_at(&controller, &q).unwrap();
        let (pose, jacobian) = controller.model().kinematics(&q, Reference::Local).unwrap();
        let gravity = controller.model().gravity(&q).unwrap();
        assert!(pose.position[0].is_finite() && report.axes.iter().map(|axis| axis.name).eq(["y", "z"]));
        let expected = (0..7)
            .filter(|&i| jacobian[(1, i)].abs() > 1e-9)
            .map(|i| (report.torque_limit[i] + jacobian[(1, i)].signum() * gravity[i]) / jacobian[(1, i)].abs())
            .fold(f64::INFINITY, f64::min);
        common::close("tool's y", report.axes[0].static_force[1], expected, 1e-9 * (1.0 + expected.abs()));
        assert!(report.axes.iter().flat_map(|axis| axis.host_loss_force).all(f64::is_finite));
    }
}

#[test]
fn pushes_are_along_the_axes_of_the_task() {
    // Task axes turned by 90° about z: x' is y of the base, y' is −x.
    let turned = Frame::Rotation([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    let settings = Settings { task: Task { frame: turned, ..Task::parse("all").unwrap() }, ..Settings::default() };
    let [base, turned] =
        [Settings::default(), settings].map(|settings| report_at(&controller(settings), &GRASP).unwrap());
    for (axis, other, is_reversed) in [(0, 1, false), (1, 0, true), (2, 2, false), (3, 4, false), (4, 3, true)] {
        let (got, expected) = (&turned.axes[axis], &base.axes[other]);
        for side in [0, 1] {
            let of = if is_reversed { 1 - side } else { side };
            for (got, expected) in [
                (got.path_friction[side], expected.path_friction[of]),
                (got.path_distance[side], expected.path_distance[of]),
                (got.path_sigma[side], expected.path_sigma[of]),
                (got.host_loss_force[side], expected.host_loss_force[of]),
            ] {
                assert!((got - expected).abs() <= 1e-6 * (1.0 + expected.abs()), "{axis} {side}: {got} {expected}");
            }
            assert_eq!(got.stop[side].map(|stop| stop.joint), expected.stop[of].map(|stop| stop.joint));
        }
    }
}
