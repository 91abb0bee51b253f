//! Poses: position and rotation of one frame in another.

use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::error::{Error, Result};
use crate::kinematics::spatial::{Mat3, cross, dot, sub};
use crate::model::Workspace;
use crate::number::{Arithmetic, Number, Plain};

/// Largest plausible joint coordinate.
///
/// Beyond it squares of differences lose the digits that control needs, so it is an input error.
pub const COORDINATE_BOUND: f64 = 1e6;

/// Largest plausible position [m] along an axis: no arm reaches it; larger values are usually millimetres.
pub const POSITION_BOUND: f64 = 100.0;

/// Largest allowed absolute entry of `RᵀR − I`.
pub const ROTATION_TOLERANCE: f64 = 1e-4;

/// Fast-accept threshold: if the summed residuals are below it, every entry of `RᵀR − I` is within
/// [`ROTATION_TOLERANCE`], since no entry exceeds six times the sum.
pub(crate) const DOUBT: f64 = 0.1 * ROTATION_TOLERANCE;

/// Pose of the tool in the base, `base_from_tool`: rotation matrix (row-major) and position [m].
///
/// For one configuration, or for as many as an `R` holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose<R = f64> {
    /// Rotation matrix; `rotation[row][column]`.
    pub rotation: [[R; 3]; 3],
    /// Position [m].
    pub position: [R; 3],
}

impl Pose {
    /// Identity: no rotation, no translation.
    pub const IDENTITY: Self =
        Self { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position: [0.0; 3] };

    /// Creates a pose from a homogeneous 4×4 matrix, row-major.
    ///
    /// # Errors
    /// As [`Pose::validate`]; also if the last row is not `0 0 0 1`.
    pub fn from_rows(m: &[[f64; 4]; 4]) -> Result<Self> {
        Self::from_rows_of("pose", m)
    }

    /// [`Pose::from_rows`] with the argument's name for the message.
    ///
    /// # Errors
    /// As [`Pose::from_rows`].
    pub fn from_rows_of(name: &str, m: &[[f64; 4]; 4]) -> Result<Self> {
        if !(m[3][0].abs() < 1e-9 && m[3][1].abs() < 1e-9 && m[3][2].abs() < 1e-9 && (m[3][3] - 1.0).abs() < 1e-9) {
            return Err(Error::config(
                name,
                format!("last row of a 4×4 pose must be 0 0 0 1, got {} {} {} {}", m[3][0], m[3][1], m[3][2], m[3][3]),
            ));
        }
        let pose = Self {
            rotation: [[m[0][0], m[0][1], m[0][2]], [m[1][0], m[1][1], m[1][2]], [m[2][0], m[2][1], m[2][2]]],
            position: [m[0][3], m[1][3], m[2][3]],
        };
        pose.check(name)?;
        Ok(pose)
    }

    /// Returns the homogeneous 4×4 matrix, row-major.
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let (r, p) = (&self.rotation, &self.position);
        [
            [r[0][0], r[0][1], r[0][2], p[0]],
            [r[1][0], r[1][1], r[1][2], p[1]],
            [r[2][0], r[2][1], r[2][2], p[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    }

    /// Checks that the position is finite and within [`POSITION_BOUND`] and that the rotation matrix is valid.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the entry; [`Error::Config`] the defect of the rotation.
    pub fn validate(&self) -> Result<()> {
        self.check("pose")
    }

    /// [`Pose::validate`] with the argument's name in the message.
    #[inline]
    pub(crate) fn check(&self, name: &str) -> Result<()> {
        if self.doubt::<Plain>(&Workspace::ANY) <= DOUBT { Ok(()) } else { self.explain(name) }
    }

    /// Returns true if [`Pose::check`] refuses this pose or if it is outside `workspace`; uses the fast check first.
    #[inline(always)]
    pub(crate) fn is_refused<A: Arithmetic<Real = f64>>(&self, workspace: &Workspace) -> bool {
        !(self.doubt::<A>(workspace) <= DOUBT) && self.is_wrong(workspace)
    }

    /// [`Pose::is_refused`] without the fast check.
    #[cold]
    #[inline(never)]
    fn is_wrong(&self, workspace: &Workspace) -> bool {
        workspace.excludes(&self.position) || self.explain("").is_err()
    }

    /// Returns the error of an invalid pose.
    #[cold]
    #[inline(never)]
    fn explain(&self, name: &str) -> Result<()> {
        for (axis, &value) in ["x", "y", "z"].iter().zip(&self.position) {
            if !(value.abs() <= POSITION_BOUND) {
                let hint = if value.is_finite() { "; is it in millimetres?" } else { "" };
                let bound = format!("±{POSITION_BOUND}{hint}");
                return Err(Error::out_of_range(format!("{name}: position {axis} [m]"), value, bound));
            }
        }
        let mut worst: f64 = 0.0;
        for i in 0..3 {
            for j in 0..3 {
                let error = orthogonality_error::<Plain>(&self.rotation, i, j);
                // `max` would drop a NaN.
                worst = if error > worst || error.is_nan() { error } else { worst };
            }
        }
        if worst <= ROTATION_TOLERANCE && determinant::<Plain>(&self.rotation) >= 0.0 {
            return Ok(());
        }
        if worst <= ROTATION_TOLERANCE {
            return Err(Error::config(name, "rotation part is a reflection (determinant −1); swap or negate an axis"));
        }
        Err(Error::config(
            name,
            format!(
                "rotation part is not a rotation: largest entry of RᵀR − I is {worst:.3e}, at most {ROTATION_TOLERANCE:e}"
            ),
        ))
    }

    /// Converts to nalgebra's isometry.
    pub fn to_isometry(&self) -> Isometry3<f64> {
        let r = &self.rotation;
        let m = Matrix3::new(r[0][0], r[0][1], r[0][2], r[1][0], r[1][1], r[1][2], r[2][0], r[2][1], r[2][2]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m));
        Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation)
    }

    /// Creates a pose from nalgebra's isometry.
    pub fn from_isometry(isometry: &Isometry3<f64>) -> Self {
        let m: Matrix4<f64> = isometry.to_homogeneous();
        Self {
            rotation: [
                [m[(0, 0)], m[(0, 1)], m[(0, 2)]],
                [m[(1, 0)], m[(1, 1)], m[(1, 2)]],
                [m[(2, 0)], m[(2, 1)], m[(2, 2)]],
            ],
            position: [m[(0, 3)], m[(1, 3)], m[(2, 3)]],
        }
    }
}

impl<R: Copy> Pose<R> {
    /// Sum of residuals; a pose with a sum of at most [`DOUBT`] is valid: one comparison instead of many.
    ///
    /// The third row of a rotation is the cross product of the other two, which are orthonormal.
    #[inline(always)]
    fn doubt<A: Arithmetic<Real = R>>(&self, workspace: &Workspace) -> R
    where
        R: Number,
    {
        let ([x, y, z], centre) = (&self.rotation, workspace.centre.map(A::splat));
        let [a, b, c] = sub::<A>(&self.position, &centre);
        let (one, off) = (A::splat(1.0), sub::<A>(&cross::<A>(x, y), z));
        let lengths = A::abs(dot::<A>(x, x) - one) + A::abs(dot::<A>(y, y) - one);
        let angles = A::abs(dot::<A>(x, y)) + (A::abs(off[0]) + A::abs(off[1]) + A::abs(off[2]));
        // The sum of the components is at least the distance.
        let far = A::abs(a) + A::abs(b) + A::abs(c);
        A::fma(A::splat(workspace.doubt), far, lengths + angles)
    }

    /// Returns `fine` if this pose passes the fast check within `workspace`, 0 if [`Pose::is_refused`] must decide.
    #[inline(always)]
    pub(crate) fn if_sure<A: Arithmetic<Real = R>>(&self, workspace: &Workspace, mut fine: R) -> R {
        let (nothing, radius) = (A::splat(0.0), workspace.radius);
        let apart = sub::<A>(&self.position, &workspace.centre.map(A::splat));
        fine = A::if_less(dot::<A>(&apart, &apart), A::splat(radius * radius), fine, nothing);
        for i in 0..3 {
            for j in 0..=i {
                let error = orthogonality_error::<A>(&self.rotation, i, j);
                fine = A::if_less(error, A::splat(ROTATION_TOLERANCE), fine, nothing);
            }
        }
        A::if_less(nothing, determinant::<A>(&self.rotation), fine, nothing)
    }
}

/// Returns the absolute value of one entry of `RᵀR − I`.
#[inline(always)]
fn orthogonality_error<A: Arithmetic>(r: &Mat3<A::Real>, i: usize, j: usize) -> A::Real {
    let product = dot::<A>(&[r[0][i], r[1][i], r[2][i]], &[r[0][j], r[1][j], r[2][j]]);
    A::abs(product - A::splat(f64::from(u8::from(i == j))))
}

#[inline(always)]
fn determinant<A: Arithmetic>(r: &Mat3<A::Real>) -> A::Real {
    dot::<A>(&r[0], &cross::<A>(&r[1], &r[2]))
}
