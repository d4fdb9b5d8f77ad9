//! Where the centre of a fitted mark is, and how sure that is.
//!
//! The scatter of the centre by what a fit leaves over knows neither what the fit absorbs (a shift of both edges alike
//! is a shift of the mark) nor errors of the model. Both show in the same residuals: the more is left over on the
//! border, the smoother the border and the shorter the edges, the further the centre is off. How far was measured on
//! planted marks, by a generalised linear model with a logarithmic link (J. A. Nelder and R. W. M. Wedderburn,
//! "Generalized linear models", Journal of the Royal Statistical Society A 135(3), 1972) of the squared error of 40,000
//! coordinates on what each fit saw, all uncovered conditions of `docs/benchmark-detection.md` weighted alike, on all
//! covers but `IMG_0046`. Nothing in it knows a condition. What a strip that is lost on one side leaves open is
//! reasoned, not fitted ([`cut_side`]).

use super::fit::Fit;
use super::jpeg_fit::Refined;
use super::kernels::Form;

/// A centre in the patch and its covariance.
pub(super) struct Place {
    pub x: f64,
    pub y: f64,
    /// xx, xy, yy.
    pub covariance_px2: [f64; 3],
}

/// Centres are not known better than this, pixels.
const FLOOR_PX: f64 = 0.01;
/// Of the logarithm of the variance: constant; logarithms of the scatter, of the scatter of one axis over the mean of
/// both, of what is left over, of side and blur in pixels, and the square of the logarithm of the side over 10 px;
/// edges at 45° to the pixel grid.
const CONSTANT: f64 = 7.62;
const SCATTER: f64 = 0.274;
const AXIS: f64 = 0.328;
const RMS: f64 = 2.458;
const SIDE: f64 = -1.93;
const SIDE_SQUARED: f64 = 0.702;
const BLUR: f64 = 2.447;
const ACROSS_GRID: f64 = 0.402;

impl Place {
    /// The centre of a fit, and how well it is known.
    pub fn of(fit: &Fit) -> Place {
        Place { x: fit.x, y: fit.y, covariance_px2: covariance(fit) }
    }

    /// Optics mix paint and ground in linear light, image editors and resampling in sRGB; where the grounds on two
    /// sides differ the two models put the edges differently. The picture tells little about which holds, so the
    /// centres are averaged, weighted by how well each explains the border, and their difference widens the covariance.
    /// The second answer is what was added to the covariance.
    pub fn averaged_with(self, fit: &Fit, other: &Fit) -> (Place, [f64; 3]) {
        let (dx, dy) = (other.x - fit.x, other.y - fit.y);
        let weight = weight(fit, other, dx.hypot(dy));
        let spread = [dx * dx, dx * dy, dy * dy].map(|d| weight * (1.0 - weight) * d);
        let covariance_px2 = std::array::from_fn(|k| self.covariance_px2[k] + spread[k]);
        (Place { x: self.x + weight * dx, y: self.y + weight * dy, covariance_px2 }, spread)
    }

    /// The place by the fit to a JPEG's coefficients, where there is one: moved and widened by the other mixing as the
    /// fit to pixels (`fit`) is here. Its covariance follows from rounding and texture as measured in the patch, and
    /// from nothing that was fitted to planted marks.
    pub fn refined(self, fit: &Fit, spread_px2: [f64; 3], refined: &Refined) -> Place {
        const FLOOR_PX: f64 = 0.005;
        let [xx, xy, yy] = refined.covariance_px2;
        let [a, b] = refined.sides_px;
        let extra = FLOOR_PX * FLOOR_PX + hidden(fit, (a * b).sqrt().max(6.0)) + come_off(fit);
        let cut = if fit.form == Form::Disc {
            [0.0; 3]
        } else {
            cut_side(refined.sides_px, refined.angle_rad, (xx + yy) / 2.0 + extra)
        };
        Place {
            x: refined.x + self.x - fit.x,
            y: refined.y + self.y - fit.y,
            covariance_px2: [
                xx + extra + cut[0] + spread_px2[0],
                xy + cut[1] + spread_px2[1],
                yy + extra + cut[2] + spread_px2[2],
            ],
        }
    }
}

/// Chance that the mark was mixed in linear light: a logistic regression on planted marks of both kinds (how much
/// better the border is explained says more the further the centres are apart), with even odds moved to 1 : 2.7 because
/// pictures are resampled and compressed after development.
fn weight(fit: &Fit, other: &Fit, distance_px: f64) -> f64 {
    const ODDS: f64 = -1.0;
    // No mixing moves a centre further: one of the fits ran away.
    const MOST_PX: f64 = 0.75;
    if distance_px > MOST_PX {
        return 0.0;
    }
    let better = (fit.edge_sd / other.edge_sd).ln();
    let apart = (distance_px + 0.02).ln();
    let logit = ODDS + 0.79 + 3.52 * better + 0.25 * apart + 0.94 * better * apart;
    1.0 / (1.0 + (-logit).exp())
}

fn covariance(fit: &Fit) -> [f64; 3] {
    let side = (fit.sides_px[0] * fit.sides_px[1]).sqrt();
    let [sxx, sxy, syy] = fit.scatter_px2;
    // Conditions were planted up to 30 px: no extrapolation.
    let log_side = side.clamp(4.0, 40.0).ln();
    let common = CONSTANT
        + SCATTER * (sxx + syy + 1e-7).ln()
        + RMS * fit.rms.max(1e-3).ln()
        + SIDE * log_side
        + SIDE_SQUARED * (log_side - 2.3).powi(2)
        + BLUR * fit.blur_px.clamp(0.5, 4.0).ln()
        + ACROSS_GRID * across_grid(fit, side);
    let mean = (sxx + syy) / 2.0 + 1e-6;
    let axis = |s: f64| (common + AXIS * ((s + 1e-6) / mean).ln()).clamp(-14.0, 2.0).exp();
    let (xx, yy) = (axis(sxx), axis(syy));
    // The axes differ by a power of the scatter's; so does their correlation.
    let xy = AXIS * sxy / (sxx * syy).sqrt().max(1e-12) * (xx * yy).sqrt();
    let extra = FLOOR_PX * FLOOR_PX + hidden(fit, side.max(6.0)) + come_off(fit);
    let cut = match fit.form {
        Form::Disc => [0.0; 3],
        Form::Rectangle => cut_side(fit.sides_px, fit.angle_rad, (xx + yy) / 2.0 + extra),
    };
    [xx + extra + cut[0], xy + cut[1], yy + extra + cut[2]]
}

/// What a hidden part inside the border leaves open, px²: a share of the side.
fn hidden(fit: &Fit, side: f64) -> f64 {
    ((fit.hidden - 0.02).max(0.0) * side * 0.25).powi(2)
}

/// What paint that has come off in flakes leaves open, px². The mean square of what is left over inside is the share
/// that is gone. A flake at the border moves the centre, and blur makes what is left a whole mark that is a little
/// smaller: of that nothing shows but an inside a little less even than fresh paint is. From 2,600 drawn marks of 8 to
/// 24 px that had lost 0 to 15 %.
fn come_off(fit: &Fit) -> f64 {
    /// Per share that is gone.
    const PX: f64 = 1.6;
    /// Of a mark that has lost something.
    const AT_BORDER_PX: f64 = 0.12;
    /// Fresh paint leaves over less inside than the first, paint that has lost something more than the second.
    const FRESH: (f64, f64) = (0.03, 0.06);
    let lost = ((fit.rms_inside - FRESH.0) / (FRESH.1 - FRESH.0)).clamp(0.0, 1.0);
    (PX * fit.rms_inside * fit.rms_inside).powi(2) + (AT_BORDER_PX * lost).powi(2)
}

/// A square that lost a strip along one edge (grass, sand, a shoe) is seen as a rectangle: its middle is off by half of
/// what is missing, towards one of the two short ends, and the picture does not tell which. Variance in that direction:
/// (d/2)² times the chance that a strip is lost, given the difference d of the two sides. By Bayes' rule: with nothing
/// lost d is an error of measurement; four independent edges give it √8 times the standard deviation of a coordinate of
/// the centre (on 33,000 planted marks its median is that of the half-normal distribution to 2 %, its tail a little
/// longer); otherwise any d up to half the longer side is as likely as another.
fn cut_side([a, b]: [f64; 2], angle_rad: f64, variance_px2: f64) -> [f64; 3] {
    /// Marks that are cut, of all that are put out.
    const OFTEN: f64 = 0.05;
    const LONGER_TAIL: f64 = 1.15;
    /// What lacks more of its longer side than this may be no cut square: its angle is nobody's either, and with each
    /// further share this multiple of it is open in every direction.
    const MOST_CUT: f64 = 0.2;
    const ASIDE: f64 = 2.0;
    let d = (a - b).abs();
    let sd = LONGER_TAIL * (8.0 * variance_px2).sqrt();
    let by_error = (1.0 - OFTEN) * (2.0 / std::f64::consts::PI).sqrt() / sd * (-0.5 * (d / sd).powi(2)).exp();
    let by_loss = OFTEN * 2.0 / a.max(b);
    let variance = by_loss / (by_loss + by_error) * (d / 2.0).powi(2);
    let along = if a < b { angle_rad } else { angle_rad + std::f64::consts::FRAC_PI_2 };
    let (sin, cos) = along.sin_cos();
    let aside = variance * ASIDE * (d / a.max(b) - MOST_CUT).max(0.0);
    [variance * cos * cos + aside, variance * sin * cos, variance * sin * sin + aside]
}

/// How much edges lie at 45° to the pixel grid, where every pixel of an edge errs alike: 1 exactly so, less the further
/// an edge drifts over its length.
fn across_grid(fit: &Fit, side: f64) -> f64 {
    const DRIFT_PX: f64 = 0.4;
    if fit.form == Form::Disc {
        return 0.0;
    }
    let eighth = std::f64::consts::FRAC_PI_4;
    let off = ((fit.angle_rad + eighth).rem_euclid(2.0 * eighth) - eighth).abs();
    (-(side * (eighth - off).sin() / DRIFT_PX).powi(2)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(side: f64, angle_rad: f64, rms: f64, scatter: [f64; 3]) -> Fit {
        Fit {
            form: Form::Rectangle,
            x: 5.0,
            y: 6.0,
            sides_px: [side; 2],
            angle_rad,
            blur_px: 1.5,
            height: 1.0,
            scatter_px2: scatter,
            chi2: 1.0,
            rms,
            rms_inside: 0.03,
            hidden: 0.0,
            edge_sd: 0.03,
        }
    }

    #[test]
    fn worse_fits_smaller_marks_and_edges_in_step_are_less_sure() {
        let xx = |f: &Fit| Place::of(f).covariance_px2[0];
        let usual = fit(10.0, 0.3, 0.03, [3e-4, 0.0, 3e-4]);
        assert!((0.03..0.09).contains(&xx(&usual).sqrt()), "{}", xx(&usual).sqrt());
        assert!(xx(&fit(10.0, 0.3, 0.06, [3e-4, 0.0, 3e-4])) > 2.0 * xx(&usual));
        assert!(xx(&fit(6.0, 0.3, 0.03, [3e-4, 0.0, 3e-4])) > 1.5 * xx(&usual));
        for angle in [1.0, 3.0, -5.0].map(|odd: f64| odd * std::f64::consts::FRAC_PI_4) {
            assert!(xx(&fit(10.0, angle, 0.03, [3e-4, 0.0, 3e-4])) > 1.3 * xx(&usual), "{angle}");
        }
        let long = Place::of(&fit(10.0, 0.3, 0.03, [6e-4, 1e-4, 1e-4])).covariance_px2;
        assert!(long[0] > long[2] && long[1] > 0.0 && long[0] * long[2] > long[1] * long[1]);
    }

    #[test]
    fn a_lost_strip_leaves_one_direction_open() {
        let mut cut = fit(10.0, 0.0, 0.03, [3e-4, 0.0, 3e-4]);
        let whole = Place::of(&cut).covariance_px2;
        cut.sides_px = [8.0, 10.0];
        let [xx, xy, yy] = Place::of(&cut).covariance_px2;
        // Off by a pixel to the left or to the right.
        assert!(
            (xx - whole[0] - 1.0).abs() < 0.05 && (yy - whole[2]).abs() < 0.01 && xy.abs() < 1e-6,
            "{xx} {xy} {yy}"
        );
        cut.angle_rad = std::f64::consts::FRAC_PI_4;
        let [xx, xy, yy] = Place::of(&cut).covariance_px2;
        assert!((xx - yy).abs() < 1e-6 && (xy - 0.5).abs() < 0.05, "{xx} {xy} {yy}");
        // A tenth of a pixel is what measuring gives.
        cut.sides_px = [9.9, 10.0];
        assert!(
            Place::of(&cut).covariance_px2[0]
                < 1.1 * Place::of(&fit(10.0, cut.angle_rad, 0.03, [3e-4, 0.0, 3e-4])).covariance_px2[0]
        );
    }

    #[test]
    fn two_models_that_disagree_widen_the_covariance() {
        let one = fit(10.0, 0.3, 0.03, [3e-4, 0.0, 3e-4]);
        let mut other = one.clone();
        other.x += 0.2;
        let both = Place::of(&one).averaged_with(&one, &other).0;
        assert!((5.01..5.15).contains(&both.x) && both.y == 6.0, "{}", both.x);
        assert!(both.covariance_px2[0] > Place::of(&one).covariance_px2[0] + 0.003);
        other.edge_sd = 0.015;
        assert!(Place::of(&one).averaged_with(&one, &other).0.x > both.x, "the better explanation draws it");
        other.x += 2.0;
        assert_eq!(Place::of(&one).averaged_with(&one, &other).0.x, 5.0);
    }
}
