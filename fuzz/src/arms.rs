//! Arms, servos and controllers with which the fuzz targets start; each is created once and then cloned.

use std::sync::{Arc, OnceLock};

use pliant_core::params::{Axis, CompliantSide, Damping, Follow, Frame, Law, NullSpace, Projector, Task, Tracking};
use pliant_core::{Controller, LimitType, Model, ModelOptions, Pose, Servos, Settings};

/// An arm with its servos, in a pose inside its joint limits.
#[derive(Clone)]
pub struct Arm {
    pub model: Arc<Model>,
    pub servos: Servos,
    pub q: Vec<f64>,
    pub target: Pose,
}

/// Number of arms that [`arm`] returns.
pub const ARMS: usize = 5;

/// Returns an arm by index: with seven joints, seven and a rotated base, five, two in a plane, and ten, which is more
/// than the step's vectors of eight can contain.
pub fn arm(index: usize) -> &'static Arm {
    static ALL: [OnceLock<Arm>; ARMS] = [const { OnceLock::new() }; ARMS];
    ALL[index].get_or_init(|| make(index))
}

fn make(index: usize) -> Arm {
    let ten = chain_of(10);
    let (text, tip) = [
        (include_str!("../../tests/data/golden/arm7.urdf"), Some("tool")),
        (include_str!("../../benches/arm7_bench.urdf"), None),
        (include_str!("../../python/pliant/robots/so101_like.urdf"), Some("tool")),
        (include_str!("../../rust/core/tests/data/robots/planar_2r.urdf"), Some("tool")),
        (ten.as_str(), None),
    ][index];
    let options = ModelOptions { tip: tip.map(String::from), ..ModelOptions::default() };
    let model = Model::from_urdf_str(text, &options).unwrap();
    let servos = match index {
        2 => Servos {
            friction: vec![0.08],
            damping: vec![0.6],
            armature: vec![0.028],
            limit_type: LimitType::Pwm,
            no_load_speed: Some(vec![5.0]),
            ..Servos::new(vec![5.1], vec![1.9])
        },
        _ => Servos {
            friction: vec![0.2],
            damping: vec![1.0],
            kv: vec![0.8],
            armature: vec![0.01],
            encoder_step: vec![1.5e-3],
            stiffness_known: true,
            ..Servos::new(vec![150.0], vec![60.0])
        },
    };
    let q: Vec<f64> = (0..model.n())
        .map(|i| {
            let (low, high) = (model.lower()[i].max(-3.0), model.upper()[i].min(3.0));
            low + (high - low) * (0.35 + 0.04 * i as f64)
        })
        .collect();
    let target = model.forward_kinematics(&q).unwrap();
    Arm { servos: servos.for_joints(model.n()).unwrap(), model: Arc::new(model), q, target }
}

/// Returns the URDF of a chain of light links whose axes alternate.
fn chain_of(joints: usize) -> String {
    let link = |i: usize| {
        format!(
            "<link name=\"l{i}\"><inertial><origin xyz=\"0 0 0.05\"/><mass value=\"0.1\"/>\
             <inertia ixx=\"1e-4\" ixy=\"0\" ixz=\"0\" iyy=\"1e-4\" iyz=\"0\" izz=\"1e-4\"/></inertial></link>"
        )
    };
    let joint = |i: usize| {
        format!(
            "<joint name=\"j{i}\" type=\"revolute\"><parent link=\"l{i}\"/><child link=\"l{}\"/><origin xyz=\"0 0 0.1\"/>\
             <axis xyz=\"{}\"/><limit lower=\"-2\" upper=\"2\" effort=\"60\" velocity=\"5\"/></joint>",
            i + 1,
            ["0 1 0", "1 0 0", "0 0 1"][i % 3]
        )
    };
    let links: String = (0..=joints).map(link).collect();
    let all: String = (0..joints).map(joint).collect();
    format!("<robot name=\"chain\">{links}{all}</robot>")
}

/// Number of variants of the settings for each arm and law.
const VARIANTS: usize = 4;
/// Number of controllers that [`controller`] returns.
pub const CONTROLLERS: usize = ARMS * 3 * VARIANTS;

/// Returns a controller by index: every arm under every law, with default settings and with rarely used options.
pub fn controller(index: usize) -> &'static (Arm, Controller) {
    static ALL: [OnceLock<(Arm, Controller)>; CONTROLLERS] = [const { OnceLock::new() }; CONTROLLERS];
    ALL[index].get_or_init(|| {
        let arm = arm(index % ARMS);
        let law = [Law::Cap, Law::Impedance, Law::Paper][index / ARMS % 3];
        let settings = settings(arm.model.n(), law, index / ARMS / 3);
        let controller = Controller::new(Arc::clone(&arm.model), settings, Some(arm.servos.clone()));
        (arm.clone(), controller.unwrap_or_else(|error| panic!("controller {index}: {error}")))
    })
}

fn settings(n: usize, law: Law, variant: usize) -> Settings {
    let few = n < 6;
    let axes = [true, !few, true, !few, !few, !few && variant != 1];
    let base = Settings {
        law,
        task: Task { axes, frame: Frame::Base, length: few.then_some(0.2) },
        // Instruction sets agree within the documented tolerance for a damping of at least 0.02.
        tracking: Tracking { damping: Damping::Fixed(0.05), ..Tracking::default() },
        ..Settings::default()
    };
    let soft = Axis { soft: Some([1.0; 2]), firm: Some([4.0; 2]), adaptation: 0.9, ..Axis::default() };
    match variant {
        0 => base,
        1 => {
            let mut all = base;
            all.axes[0] = Axis { yields: Some(CompliantSide::Plus), ..soft };
            all.axes[2] = Axis { deviation_limit: Some(0.02), yields: Some(CompliantSide::None), ..Axis::default() };
            all.task.frame = Frame::Tool;
            all.delay = 0.01;
            all.tracking.integrate = 1.0;
            all.null_space.limit_avoidance = 0.3;
            all.paper_options.manipulability = 0.1;
            all
        }
        2 => Settings {
            max_tool_speed: [f64::INFINITY; 2],
            gravity: false,
            tracking: Tracking { velocity_filter: 0.0, goal_slew: f64::INFINITY, ..base.tracking.clone() },
            null_space: NullSpace { projector: Projector::Paper, max_speed: 0.1, ..NullSpace::default() },
            ..base
        },
        _ => {
            let mut all = Settings { axes: [soft, soft, soft, soft, soft, soft], ..base };
            for (axis, on) in all.axes.iter_mut().zip(all.task.axes) {
                if !on {
                    *axis = Axis::default();
                }
            }
            all.paper_options.follow = (law != Law::Impedance).then_some(Follow::Hold);
            all.torque_limits.max_host_loss_force = Some(20.0);
            all
        }
    }
}
