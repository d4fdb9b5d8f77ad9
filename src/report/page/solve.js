"use strict";
// The weighted similarity of similarity.rs and adjustment.rs in crates/solve/src with the same operations in the same
// order, so that a replay of a patch gives the numbers that this page showed. Change both together; tests/program/report
// compares them.
const Fit = (() => {
  const BAARDA_SQRT_LAMBDA = 4.13, LEAST_SIGMA_PX = 0.02, LEAST_MISFIT_SIGMAS = 3.72;
  const length = (x, y) => Math.sqrt(x * x + y * y);
  const sum = (values) => values.reduce((a, b) => a + b, 0);

  // −1 of a mirrored image, else 1.
  const hand = (mirrored) => (mirrored ? -1 : 1);

  function apply(s, px, py) {
    const x = hand(s.mirrored) * px, y = -py;
    return [s.easting_0 + s.a_re * x - s.a_im * y, s.northing_0 + s.a_im * x + s.a_re * y];
  }
  function invert(s, easting, northing) {
    const e = easting - s.easting_0, n = northing - s.northing_0;
    const square = s.a_re * s.a_re + s.a_im * s.a_im;
    return [hand(s.mirrored) * ((s.a_re * e + s.a_im * n) / square), -(s.a_re * n - s.a_im * e) / square];
  }
  const scaleOf = (s) => length(s.a_re, s.a_im);
  const geotransform = (s) => [s.easting_0, hand(s.mirrored) * s.a_re, s.a_im, s.northing_0, hand(s.mirrored) * s.a_im, -s.a_re];

  function centres(pairs, weights, total) {
    const first = pairs[0], sums = [0, 0, 0, 0];
    pairs.forEach((pair, i) => {
      const d = [pair.x - first.x, pair.y - first.y, pair.e - first.e, pair.n - first.n];
      for (let k = 0; k < 4; k++) sums[k] += weights[i] * d[k];
    });
    const [x, y, e, n] = sums.map((s) => s / total);
    return { x: first.x + x, y: first.y + y, e: first.e + e, n: first.n + n };
  }

  function fit(pairs, weights, mirrored) {
    const total = sum(weights), c = centres(pairs, weights, total);
    let re = 0, im = 0, square = 0;
    pairs.forEach((pair, i) => {
      const p = weights[i], x = hand(mirrored) * (pair.x - c.x), y = -(pair.y - c.y), e = pair.e - c.e, n = pair.n - c.n;
      re += p * (x * e + y * n);
      im += p * (x * n - y * e);
      square += p * (x * x + y * y);
    });
    const a_re = re / square, a_im = im / square, scale = length(a_re, a_im);
    if (!(square > 0 && scale > 0 && Number.isFinite(scale))) return null;
    const x = hand(mirrored) * c.x, y = -c.y;
    return { a_re, a_im, easting_0: c.e - (a_re * x - a_im * y), northing_0: c.n - (a_im * x + a_re * y), mirrored };
  }

  function residual(s, pair) {
    const [e, n] = apply(s, pair.x, pair.y);
    return [pair.e - e, pair.n - n];
  }

  function priorVariances(pairs, scale) {
    return pairs.map((pair) => {
      const centre = pair.covariance ? (pair.covariance[0] + pair.covariance[2]) / 2 * scale * scale : 0;
      return centre + (pair.sigma === null ? 0 : pair.sigma * pair.sigma);
    });
  }

  // As crates/solve/src/weights.rs has it.
  function weightsOf(pairs, equal) {
    const square = (pair) => {
      const [e, n] = residual(equal, pair);
      return e * e + n * n;
    };
    return weightsFrom(pairs, scaleOf(equal), 4, () => pairs.map(square));
  }

  // Weights of mean 1 from the squared residuals of a fit with equal weights, of so many parameters.
  function weightsFrom(pairs, scale, parameters, squaresOf) {
    const freedom = 2 * pairs.length - parameters;
    const stated = pairs.map((pair) => ({
      centre: pair.covariance ? (pair.covariance[0] + pair.covariance[2]) / 2 * scale * scale : 0,
      survey: pair.sigma === null ? 0 : pair.sigma * pair.sigma,
    }));
    const same = (s) => s.centre === stated[0].centre && s.survey === stated[0].survey;
    if (freedom <= 0 || stated.every(same)) return pairs.map(() => 1);
    const squares = squaresOf();
    const floor = LEAST_SIGMA_PX * scale * (LEAST_SIGMA_PX * scale), swallowed = 2 * pairs.length / freedom;
    let most = -Infinity, best = null;
    for (const [share, odds] of [[1, 0.8], [0.1, 0.1], [0.01, 0.1]]) {
      const own = stated.map((s) => Math.max(share * s.centre + s.survey, floor));
      const variances = withCommon(own, squares, freedom);
      const terms = variances.map((v, i) => Math.log(v) + swallowed * squares[i] / (2 * v));
      const likelihood = Math.log(odds) - sum(terms);
      if (likelihood > most) [most, best] = [likelihood, variances];
    }
    const weights = best.map((v) => 1 / v), mean = sum(weights) / weights.length;
    return weights.map((w) => w / mean);
  }

  function withCommon(own, squares, freedom) {
    const expected = freedom / (1 + 4 / freedom);
    const over = (common) => sum(own.map((v, i) => squares[i] / (v + common)));
    let low = 0, high = sum(squares) / expected;
    if (over(0) <= expected) return own;
    for (let k = 0; k < 60; k++) {
      const middle = (low + high) / 2;
      if (over(middle) > expected) low = middle; else high = middle;
    }
    return own.map((v) => v + high);
  }

  function robustSigma(lengths) {
    const sorted = [...lengths].sort((a, b) => a - b), n = sorted.length;
    const median = (sorted[Math.floor((n - 1) / 2)] + sorted[Math.floor(n / 2)]) / 2;
    return median / 1.1774 * Math.sqrt(n / (n - 2));
  }

  // No mark is measured, and no point surveyed, so well that less than the least deviation tells a wrong one.
  function huberWeights(pairs, s, base) {
    const lengths = pairs.map((pair, i) => {
      const [e, n] = residual(s, pair);
      return length(e, n) * Math.sqrt(base[i]);
    });
    const sigma = Math.max(robustSigma(lengths), LEAST_SIGMA_PX * scaleOf(s)), limit = 4.5 * sigma;
    return lengths.map((l, i) => (l > limit ? base[i] * limit / l : base[i]));
  }

  // What a fit shows of one point: crates/solve/src/reliability.rs.
  function reliability({ points, freedom, weighted, sigma0, scale }, weight, leverage, [e, n]) {
    const redundancy = Math.min(Math.max(1 - leverage, 0), 1), tested = redundancy > 1e-9;
    const taken = weight * (e * e + n * n) / redundancy;
    const chance = freedom < 6 || weighted <= 0 ? 0 : (freedom / 2 - 1) * Math.log10(Math.max(1 - taken / weighted, 0));
    return {
      redundancy, tested, misfit: tested && length(e, n) / redundancy > LEAST_MISFIT_SIGMAS * LEAST_SIGMA_PX * scale && chance <= -3 - Math.log10(points),
      detectable: sigma0 !== null && redundancy > 0.02 ? BAARDA_SQRT_LAMBDA * (sigma0 / Math.sqrt(weight)) / Math.sqrt(redundancy) : null,
    };
  }

  // `pairs`: {x, y, covariance: [xx, xy, yy] | null, e, n, sigma | null}. Null when there is no solution.
  function solve(pairs, mirrored) {
    if (pairs.length < 2) return null;
    const first = fit(pairs, pairs.map(() => 1), mirrored);
    if (!first) return null;
    const base = weightsOf(pairs, first);
    let weights = base, similarity = fit(pairs, weights, mirrored);
    if (!similarity) return null;
    if (pairs.length > 3) {
      for (let round = 0; round < 20; round++) {
        const next = huberWeights(pairs, similarity, base);
        const change = next.reduce((m, w, i) => Math.max(m, Math.abs(w - weights[i])), 0);
        weights = next;
        similarity = fit(pairs, weights, mirrored);
        if (!similarity) return null;
        if (change < 1e-9) break;
      }
    }
    return describe(pairs, weights, base, similarity);
  }

  function describe(pairs, weights, base, similarity) {
    const n = pairs.length, total = sum(weights), centre = centres(pairs, weights, total);
    const arm = (pair) => {
      const x = pair.x - centre.x, y = pair.y - centre.y;
      return x * x + y * y;
    };
    const spread = sum(pairs.map((pair, i) => {
      const x = pair.x - centre.x, y = pair.y - centre.y;
      return weights[i] * (x * x + y * y);
    }));
    const residuals = pairs.map((pair) => residual(similarity, pair));
    const rmseE = Math.sqrt(sum(residuals.map((r) => r[0] * r[0])) / n);
    const rmseN = Math.sqrt(sum(residuals.map((r) => r[1] * r[1])) / n);
    const rmse = length(rmseE, rmseN), freedom = 2 * n - 4, scale = scaleOf(similarity);
    const weighted = sum(residuals.map((r, i) => weights[i] * (r[0] * r[0] + r[1] * r[1])));
    const sigma0 = freedom > 0 ? Math.sqrt(weighted / freedom) : null;
    const variance = sigma0 !== null ? sigma0 * sigma0 : sum(priorVariances(pairs, scale)) / n;
    const noise = { points: n, freedom, weighted, sigma0, scale };
    const rows = pairs.map((pair, i) => {
      const [e, no] = residuals[i];
      const own = reliability(noise, weights[i], weights[i] * (1 / total + arm(pair) / spread), residuals[i]);
      return {
        e, n: no, length: length(e, no), px: length(e, no) / scale, weight: weights[i], redundancy: own.redundancy,
        leaveOneOut: own.tested ? length(e / own.redundancy, no / own.redundancy) : null,
        detectable: own.detectable, outlier: weights[i] < 0.999 * base[i] || own.misfit,
      };
    });
    return { similarity, scale, rotation: Math.atan2(similarity.a_im, similarity.a_re) * 180 / Math.PI, rmse, rmseE, rmseN,
      rmsePx: rmse / scale, sigma0, variance, freedom, total, spread, centre, rows };
  }

  // Radii that hold the true position in 95 of 100 cases at a distance (px) from the centre of the marks, as src/accuracy/
  // error_map.rs has them: of the transform alone, and of a point read off the image. Null when nothing is known of the noise.
  function radius95(solution) {
    if (!solution || !(solution.variance > 0)) return null;
    const v = solution.freedom;
    const quantile = (v > 0 ? Math.sqrt(v * (Math.pow(0.05, -2 / v) - 1)) : Math.sqrt(-2 * Math.log(0.05))) * Math.sqrt(solution.variance);
    return {
      at: (distance) => quantile * Math.sqrt(1 / solution.total + distance * distance / solution.spread),
      point: (distance) => quantile * Math.sqrt(1 + 1 / solution.total + distance * distance / solution.spread),
      // The distance at which the radius is r.
      distance: (r) => Math.sqrt(Math.max((r / quantile) * (r / quantile) - 1 / solution.total, 0) * solution.spread),
    };
  }

  return { solve, apply, invert, geotransform, radius95, weightsFrom, reliability };
})();
