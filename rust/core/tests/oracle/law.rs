//! Laws of the oracle: lines 7 to 9 of the listing in docs/derivations.md, and law `paper`. Matrices are inverted as in
//! the formulas.

use pliant_core::params::Follow;

use super::shares::Shares;
use super::{Matrix, Oracle, Vector};

/// Inputs of a law in one step; one entry per row of the task, or per joint.
pub(super) struct LawInput<'a> {
    pub(super) oracle: &'a Oracle,
    pub(super) rows: &'a Matrix,
    pub(super) scaled: &'a Matrix,
    pub(super) row_lambda2: &'a Vector,
    pub(super) sigma: [f64; 2],
    pub(super) softness: &'a Vector,
    pub(super) strength: &'a Vector,
    pub(super) max_strength: &'a Vector,
    pub(super) soft_step: &'a Vector,
    /// Task displacement h Δx, clipped to the limits of each axis [m, rad].
    pub(super) step: &'a Vector,
    pub(super) adapted: &'a Vector,
    /// Stiffness of each row [N/m, N·m/rad].
    pub(super) stiffness: &'a Vector,
    /// Damping of each row [N·s/m, N·m·s/rad].
    pub(super) viscosity: &'a Vector,
    /// Joint velocity [rad/s].
    pub(super) velocity: &'a Vector,
    /// Velocity of the target minus that of the tool [m/s, rad/s].
    pub(super) relative: &'a Vector,
    pub(super) gradient: &'a Vector,
    pub(super) in_goal: &'a Vector,
    /// Feed-forward of each joint without load [N·m].
    pub(super) idle: &'a Vector,
    /// Additional feed-forward of each joint per load torque [1].
    pub(super) loaded: &'a Vector,
}

/// Result of a law in one step.
#[derive(Clone)]
pub(super) struct Motion {
    /// Lead of the goals that moves the arm [rad].
    pub(super) lead: Vector,
    /// Lead of the goals that exerts the force of soft axes [rad].
    pub(super) force: Vector,
    pub(super) null: Vector,
    pub(super) wrench: Vector,
    pub(super) feed_forward: Vector,
    pub(super) factors: [f64; 3],
    /// Factor ≤ 1 on the stiffness, from the spectral radius ρ.
    pub(super) derating: f64,
}

pub(super) fn inverse(m: &Matrix) -> Matrix {
    m.clone().lu().try_inverse().unwrap()
}

pub(super) fn diagonal(v: &Vector) -> Matrix {
    Matrix::from_diagonal(v)
}

/// Returns the largest factor in [0, 1] on `part` that brings `others + part` within ±`bound`, in every joint that is
/// outside.
fn fit(others: &Vector, part: &Vector, bound: &Vector) -> f64 {
    let mut factor: f64 = 1.0;
    for i in 0..part.len() {
        let all = others[i] + part[i];
        if all.abs() > bound[i] * (1.0 + 1e-9) && part[i].abs() > bound[i] * 1e-9 {
            factor = factor.min(((bound[i] * all.signum() - others[i]) / part[i]).clamp(0.0, 1.0));
        }
    }
    factor
}

fn past_limit(sum: &Vector, bound: &Vector) -> bool {
    (0..sum.len()).any(|i| sum[i].abs() > bound[i] * (1.0 + 1e-9))
}

impl LawInput<'_> {
    fn n(&self) -> usize {
        self.rows.ncols()
    }

    fn k(&self) -> usize {
        self.rows.nrows()
    }

    /// Returns the compliance of the tool on the servos, `C = J K_p⁻¹ Jᵀ`.
    fn c(&self) -> Matrix {
        self.rows * inverse(&diagonal(&self.oracle.kp())) * self.rows.transpose()
    }

    /// Returns the diagonal matrix `λ²/k̄`.
    fn damping(&self) -> Matrix {
        diagonal(self.row_lambda2) / self.oracle.kp().mean()
    }

    fn follow(&self) -> Follow {
        self.oracle.settings.effective_follow()
    }

    /// Returns the first half of line 8 of the listing: `(C_RR + diag(C_jj w/(1 − w)) + λ²/k̄ I)⁻¹ s_R` for the rows
    /// with w < 1; 0 for the others.
    fn stiff(&self, s: &Vector) -> Vector {
        let (c, damping) = (self.c(), self.damping());
        let remaining: Vec<usize> = (0..self.k()).filter(|&r| self.softness[r] < 1.0).collect();
        let mut out = Vector::zeros(self.k());
        if remaining.is_empty() {
            return out;
        }
        let m = Matrix::from_fn(remaining.len(), remaining.len(), |a, b| {
            let (r, t) = (remaining[a], remaining[b]);
            let own = if a == b { c[(r, r)] * self.softness[r] / (1.0 - self.softness[r]) } else { 0.0 };
            c[(r, t)] + damping[(r, t)] + own
        });
        let w = inverse(&m) * Vector::from_fn(remaining.len(), |a, _| s[remaining[a]]);
        remaining.iter().zip(w.iter()).for_each(|(&r, &value)| out[r] = value);
        out
    }

    pub(super) fn cap(&self) -> Motion {
        let k = self.k();
        let settings = &self.oracle.settings;
        let c = self.c();
        let (mut soft, mut stiff) = (Vector::zeros(k), Vector::zeros(k));
        if self.follow() == Follow::Free {
            stiff = self.stiff(self.step);
            for j in 0..k {
                let f = self.strength[j];
                let force = if self.soft_step[j] == 0.0 { 0.0 } else { self.soft_step[j] / c[(j, j)] };
                soft[j] = self.softness[j] * force.max(-f).min(f);
            }
        } else {
            let s = Vector::from_fn(k, |j, _| {
                let max_step = self.strength[j] * c[(j, j)];
                (1.0 - self.softness[j]) * self.step[j] + self.softness[j] * self.step[j].max(-max_step).min(max_step)
            });
            let w = inverse(&(&c + self.damping())) * s;
            for j in 0..k {
                soft[j] = self.softness[j] * w[j];
                stiff[j] = (1.0 - self.softness[j]) * w[j];
            }
        }

        // Line 9: −α h N ∇cost, with Σ k_p |null| ≤ τ₀ and the speed limit of the null space.
        let alpha = settings.null_space.gain.unwrap_or_else(|| largest(settings));
        let null = self.shares().projector() * self.gradient * (-alpha * settings.paper_options.horizon);
        self.exert(&soft, &stiff, null)
    }

    /// Returns the motion of law `impedance`: `F = clip(K ẽ − D v, ±max_strength)` per axis, with ρ(K) at most `max(1,
    /// 0.03 s / T_e)`, or 3 (2 for estimated servos) if the lead of a servo at full torque is above 0.15 rad, and ρ(D) at most `0.007 s² / (T_e +
    /// T_f)`.
    pub(super) fn impedance(&self) -> Motion {
        let (settings, kp) = (&self.oracle.settings, self.oracle.kp());
        let within = |gains: &Vector, bound: f64| {
            let root = diagonal(&gains.map(f64::sqrt));
            let eigenvalues = (&root * self.c() * &root).symmetric_eigenvalues();
            let top = eigenvalues.max();
            // The 64-norm of the eigenvalues approximates the largest of them.
            let rho =
                if top > 0.0 { top * eigenvalues.map(|x| (x / top).powi(64)).sum().powf(1.0 / 64.0) } else { 0.0 };
            if rho > bound { bound / rho } else { 1.0 }
        };
        let late = self.oracle.delay + 0.5 / settings.rate;
        let least = if self.oracle.well_damped() && late <= 0.03 { 3.0 } else { 1.0 };
        let slow = if self.is_known() { 3.0 } else { 2.0 };
        let max = if self.oracle.ceiling().component_div(&kp).max() > 0.15 { slow } else { f64::INFINITY };
        let derating = within(self.stiffness, (0.03 / late).max(least).min(max));
        let damped = within(self.viscosity, 0.007 / (late + settings.tracking.velocity_filter)) * self.viscosity;
        let force = Vector::from_fn(self.k(), |r, _| {
            let wanted = derating * self.stiffness[r] * self.adapted[r] + damped[r] * self.relative[r];
            wanted.max(-self.max_strength[r]).min(self.max_strength[r])
        });
        let null = if let Some(kappa) = settings.null_space.stiffness {
            (self.shares().projector() * self.gradient * -kappa).component_div(&kp)
        } else {
            let alpha = settings.null_space.gain.unwrap_or_else(|| largest(settings));
            self.shares().projector() * self.gradient * (-alpha * settings.paper_options.horizon)
        };
        let soft = force.component_mul(self.softness);
        let stiff = &force - &soft;
        Motion { derating, ..self.exert(&soft, &stiff, null) }
    }

    /// Returns `K_p⁻¹ Jᵀ (soft + stiff)` and the null-space part, scaled to torque ceilings and joint speeds.
    fn exert(&self, soft: &Vector, stiff: &Vector, mut null: Vector) -> Motion {
        let (n, k, kp) = (self.n(), self.k(), self.oracle.kp());
        let settings = &self.oracle.settings;
        let torque: f64 = (0..n).map(|i| kp[i] * null[i].abs()).sum();
        let max_torque = settings.null_space.max_torque.unwrap_or(if k < n { 2.0 } else { 0.0 });
        if torque > max_torque {
            null *= max_torque / torque;
        }
        null *= self.null_speed_factor(&null);

        // Above the ceiling W is reduced, its soft part first, then its stiff part; gravity and feed-forward are not.
        let ceiling = self.oracle.ceiling();
        let (tau_soft, tau_stiff) = (self.rows.transpose() * soft, self.rows.transpose() * stiff);
        let snapshot = (self.in_goal + &tau_soft + &tau_stiff).zip_map(&ceiling, |torque, max| torque.abs().min(max));
        let feed_forward = self.within_opposition(self.idle + self.loaded.component_mul(&snapshot), soft);
        let base = self.in_goal + &feed_forward + kp.component_mul(&null);
        let (mut f_soft, mut f_stiff) = (1.0, 1.0);
        if past_limit(&(&base + &tau_soft + &tau_stiff), &ceiling) {
            f_soft = fit(&(&base + &tau_stiff), &tau_soft, &ceiling);
            if past_limit(&(&base + &tau_soft * f_soft + &tau_stiff), &ceiling) {
                f_stiff = fit(&(&base + &tau_soft * f_soft), &tau_stiff, &ceiling);
            }
        }
        // At a joint speed limit the parts are reduced in the order null-space, soft, stiff.
        let lead_soft = (tau_soft * f_soft).component_div(&kp);
        let lead_stiff = (tau_stiff * f_stiff).component_div(&kp);
        let [f_null, g_soft, g_stiff] = self.slower(&null, &lead_soft, &lead_stiff);
        Motion {
            lead: lead_stiff * g_stiff,
            force: lead_soft * g_soft,
            null: null * f_null,
            feed_forward,
            wrench: soft * (f_soft * g_soft) + stiff * (f_stiff * g_stiff),
            factors: [f_null, f_soft * g_soft, f_stiff * g_stiff],
            derating: 1.0,
        }
    }

    /// Returns the feed-forward; of estimated friction and damping, the half that may be too much is reduced to what
    /// the axes oppose, each for its share of the tool's velocity.
    fn within_opposition(&self, feed_forward: Vector, soft: &Vector) -> Vector {
        if self.is_known() {
            return feed_forward;
        }
        let uncertain = 0.5 * feed_forward.component_mul(self.velocity).abs().sum();
        let (speed, scaled) = ((self.rows * self.velocity).abs(), (self.scaled * self.velocity).abs());
        let opposed: f64 = (0..self.k())
            .map(|r| {
                // The reference is at rest, so the hold of stiff axes has no power.
                (uncertain * scaled[r] / scaled.sum()).min(soft[r].abs() * speed[r])
            })
            .sum();
        feed_forward * if uncertain > 0.0 { 0.5 + 0.5 * opposed / uncertain } else { 1.0 }
    }

    fn is_known(&self) -> bool {
        self.oracle.servos.as_ref().is_none_or(|servos| servos.stiffness_known)
    }

    /// Returns the factor that keeps the null-space motion within its own speed limit.
    fn null_speed_factor(&self, null: &Vector) -> f64 {
        let settings = &self.oracle.settings;
        let fastest = null.amax() / settings.paper_options.horizon;
        if fastest > settings.null_space.max_speed { settings.null_space.max_speed / fastest } else { 1.0 }
    }

    /// Returns the factors on the three parts that keep `(null + soft + stiff) / h` within the joint speed limits. The
    /// parts are reduced in this order.
    fn slower(&self, null: &Vector, soft: &Vector, stiff: &Vector) -> [f64; 3] {
        let settings = &self.oracle.settings;
        let bound = Vector::from_fn(self.n(), |i, _| {
            let speed = match &settings.tracking.joint_speed {
                Some(speed) => speed[i],
                None => self.oracle.model.velocity_limit()[i].unwrap_or(f64::INFINITY),
            };
            speed * settings.paper_options.horizon
        });
        let mut factors = [1.0; 3];
        if past_limit(&(null + soft + stiff), &bound) {
            factors[0] = fit(&(soft + stiff), null, &bound);
            if past_limit(&(null * factors[0] + soft + stiff), &bound) {
                factors[1] = fit(&(null * factors[0] + stiff), soft, &bound);
                if past_limit(&(null * factors[0] + soft * factors[1] + stiff), &bound) {
                    factors[2] = fit(&(null * factors[0] + soft * factors[1]), stiff, &bound);
                }
            }
        }
        factors
    }

    /// Returns the motion of law `paper`: `h K_q (J⁺Δx − αN∇g)`; under `Follow::Free` with J⁺ of the stiff rows only.
    pub(super) fn paper(&self) -> Motion {
        let (n, k, kp) = (self.n(), self.k(), self.oracle.kp());
        let settings = &self.oracle.settings;
        let (h, shares) = (settings.paper_options.horizon, self.shares());
        let pinv = shares.pseudo_inverse();
        let mut s = self.step.clone();
        if settings.paper_options.budget_on_goal {
            for j in 0..k {
                let reach: f64 = (0..n).map(|i| kp[i] * pinv[(i, j)].abs()).sum();
                let budget = self.max_strength[j] / (h * reach) * h;
                s[j] = s[j].max(-budget).min(budget);
            }
        }
        let task = if self.follow() == Follow::Hold {
            &pinv * &s
        } else {
            let kappa = inverse(&(self.c() + self.damping()));
            let mut w = self.stiff(&s);
            (0..k).for_each(|j| w[j] += self.softness[j] * kappa[(j, j)] * s[j]);
            (self.rows.transpose() * w).component_div(&kp)
        };
        let alpha = settings.null_space.gain.unwrap_or_else(|| largest(settings));
        let null = shares.projector() * self.gradient * (-alpha * h);
        let kq = Oracle::gain(&settings.paper_options.kq, n);
        let (lead, mut null) = (&kq * task, &kq * null);
        let zero = Vector::zeros(n);
        null *= self.null_speed_factor(&null);
        let [f_null, f_task, _] = self.slower(&null, &lead, &zero);
        null *= f_null;
        Motion {
            lead: lead * f_task,
            force: zero,
            null,
            wrench: Vector::zeros(k),
            feed_forward: Vector::zeros(n),
            factors: [f_null, f_task, f_task],
            derating: 1.0,
        }
    }

    /// Returns `all` with the lead of each locked joint set to its entry in `fixed`. The other joints make up for the
    /// task motion that is lost thereby, as far as torque ceilings and speed limits allow; their pseudo-inverse has the
    /// damping of a singular pose.
    pub(super) fn redistributed(&self, all: &Motion, locked: &[bool], fixed: &Vector) -> Motion {
        let (n, kp, settings) = (self.n(), self.oracle.kp(), &self.oracle.settings);
        let whole = &all.lead + &all.null;
        let of = |on: bool, v: &Vector| Vector::from_fn(n, |i, _| if locked[i] == on { v[i] } else { 0.0 });
        let lost = self.rows * of(true, &(&whole - fixed));
        let mut rows = self.rows.clone();
        (0..n).filter(|&i| locked[i]).for_each(|i| rows.column_mut(i).fill(0.0));

        let [lambda_0, _, lambda_max] = self.oracle.damping;
        let lambda2 = lambda_0 * lambda_0 + lambda_max.max(0.05).powi(2);
        let row_lambda2 = self.row_scale() * lambda2;
        let free = self.follow() == Follow::Free;
        let none = Vector::zeros(self.k());
        let rest = LawInput {
            rows: &rows,
            row_lambda2: &row_lambda2,
            softness: if free { self.softness } else { &none },
            ..*self
        };
        let mut wrench = none.clone();
        let mut more = if settings.law == pliant_core::params::Law::Paper && !free {
            rest.shares().pseudo_inverse() * &lost
        } else {
            wrench = rest.stiff(&lost);
            (rows.transpose() * &wrench).component_div(&kp)
        };
        let mut factor = 1.0;
        if settings.law == pliant_core::params::Law::Paper {
            wrench.fill(0.0);
        } else {
            let base = of(false, &(self.in_goal + &all.feed_forward + kp.component_mul(&(&whole + &all.force))));
            let torque = kp.component_mul(&more);
            if past_limit(&(&base + &torque), &self.oracle.ceiling()) {
                factor = fit(&base, &torque, &self.oracle.ceiling());
            }
        }
        let before = of(false, &(&whole + &all.force));
        let zero = Vector::zeros(n);
        factor = factor.min(self.slower(&zero, &more, &before)[1]);
        more *= factor;
        Motion {
            lead: of(false, &(&all.lead + &more)) + of(true, fixed),
            force: all.force.clone(),
            null: of(false, &all.null),
            wrench: &all.wrench + wrench * factor,
            feed_forward: all.feed_forward.clone(),
            factors: all.factors,
            derating: all.derating,
        }
    }

    /// Returns the factor on λ² of each row: length² for translations, but 1 if λ is fixed as in the paper.
    fn row_scale(&self) -> Vector {
        let oracle = self.oracle;
        let axes = oracle.axes();
        let printed =
            matches!(oracle.settings.tracking.damping, pliant_core::params::Damping::Fixed(_)) && self.k() <= self.n();
        Vector::from_fn(self.k(), |r, _| if axes[r] < 3 && !printed { oracle.length().powi(2) } else { 1.0 })
    }

    fn shares(&self) -> Shares<'_> {
        Shares {
            oracle: self.oracle,
            rows: self.rows,
            scaled: self.scaled,
            row_lambda2: self.row_lambda2,
            sigma: self.sigma,
        }
    }
}

/// Returns the default of α: the largest gain K_x.
pub(super) fn largest(settings: &pliant_core::Settings) -> f64 {
    use pliant_core::params::Gain;
    match &settings.tracking.gain {
        Gain::Scalar(k) => *k,
        Gain::Diagonal(d) => d.iter().copied().fold(0.0, f64::max),
        Gain::Matrix(m) => m.iter().flatten().copied().fold(0.0, f64::max),
    }
}
