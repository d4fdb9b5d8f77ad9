// The affine and projective transforms of crates/solve/src/planar.rs, for runs that chose one. The same equations; their least
// squares go by one-sided Jacobi rotations (J. C. Nash, "A one-sided transformation method for the singular value
// decomposition and algebraic eigenproblem", The Computer Journal 18, 1975) where Rust has nalgebra's decomposition.
// tests/program/report compares the results.
const Planar = (() => {
  const RANK = 1e-6, ARM = 65536;
  const sum = (values) => values.reduce((a, b) => a + b, 0);
  const fewest = { affine: 3, projective: 4 };

  // Solves columns·x ≈ right; null when the columns are dependent. `columns` is changed.
  function leastSquares(columns, right) {
    const n = columns.length, dot = (a, b) => a.reduce((s, v, i) => s + v * b[i], 0);
    const turns = columns.map((_, i) => columns.map((__, j) => (i === j ? 1 : 0)));
    for (let sweep = 0; sweep < 60; sweep++) {
      let worst = 0;
      for (let p = 0; p < n - 1; p++) {
        for (let q = p + 1; q < n; q++) {
          const a = dot(columns[p], columns[p]), b = dot(columns[q], columns[q]), c = dot(columns[p], columns[q]);
          if (a * b === 0) continue;
          worst = Math.max(worst, Math.abs(c) / Math.sqrt(a * b));
          if (Math.abs(c) <= 1e-16 * Math.sqrt(a * b)) continue;
          const zeta = (b - a) / (2 * c), t = (zeta < 0 ? -1 : 1) / (Math.abs(zeta) + Math.sqrt(1 + zeta * zeta));
          const cos = 1 / Math.sqrt(1 + t * t), sin = cos * t;
          for (const pair of [columns, turns]) {
            const x = pair[p], y = pair[q];
            pair[p] = x.map((v, i) => cos * v - sin * y[i]);
            pair[q] = x.map((v, i) => sin * v + cos * y[i]);
          }
        }
      }
      if (worst < 1e-15) break;
    }
    const squares = columns.map((c) => dot(c, c)), most = Math.max(...squares);
    if (!(Math.sqrt(Math.min(...squares)) > RANK * Math.sqrt(most))) return null;
    const along = columns.map((c, k) => dot(c, right) / squares[k]);
    return turns[0].map((_, i) => sum(along.map((v, k) => v * turns[k][i])));
  }

  // Centroids count every point alike; `root` is the root of a weight.
  function normalise(pairs, weights) {
    const n = pairs.length, first = pairs[0], mean = (f) => sum(pairs.map(f)) / n;
    const x = first.x + mean((p) => p.x - first.x), y = first.y + mean((p) => p.y - first.y);
    const e = first.e + mean((p) => p.e - first.e), north = first.n + mean((p) => p.n - first.n);
    const pixel = Math.sqrt(mean((p) => (p.x - x) ** 2 + (p.y - y) ** 2)), map = Math.sqrt(mean((p) => (p.e - e) ** 2 + (p.n - north) ** 2));
    if (!(pixel > 0 && Number.isFinite(pixel) && map > 0 && Number.isFinite(map))) return null;
    return { x, y, e, n: north, pixel, map,
      local: pairs.map((p, i) => ({ u: (p.x - x) / pixel, v: (p.y - y) / pixel, e: (p.e - e) / map, n: (p.n - north) / map, root: Math.sqrt(weights[i]) })) };
  }

  function affine(local) {
    const design = () => [local.map((p) => p.root * p.u), local.map((p) => p.root * p.v), local.map((p) => p.root)];
    const e = leastSquares(design(), local.map((p) => p.root * p.e)), n = leastSquares(design(), local.map((p) => p.root * p.n));
    return e && n && [...e, ...n, 0, 0, 1];
  }

  const image = (h, u, v) => [h[0] * u + h[1] * v + h[2], h[3] * u + h[4] * v + h[5], h[6] * u + h[7] * v + h[8]];
  const columnsOf = (rows) => rows[0].map((_, k) => rows.map((row) => row[k]));

  function projective(local) {
    const rows = local.flatMap(({ u, v, e, n, root }) =>
      [[u, v, 1, 0, 0, 0, -u * e, -v * e], [0, 0, 0, u, v, 1, -u * n, -v * n]].map((row) => row.map((term) => root * term)));
    const h = leastSquares(columnsOf(rows), local.flatMap((p) => [p.root * p.e, p.root * p.n]));
    return h && [...h, 1];
  }
  function misfits(local, h) {
    const all = [];
    for (const p of local) {
      const v = image(h, p.u, p.v);
      if (v[2] <= 1e-9) return null;
      all.push(p.root * (p.e - v[0] / v[2]), p.root * (p.n - v[1] / v[2]));
    }
    return all;
  }
  function refine(local, start) {
    const square = (m) => sum(m.map((v) => v * v));
    let h = start, misfit = misfits(local, h);
    if (!misfit) return null;
    for (let round = 0; round < 30; round++) {
      const rows = local.flatMap(({ u, v, root }) => {
        const w = image(h, u, v), a = u / w[2], b = v / w[2];
        return [[a, b, 1 / w[2], 0, 0, 0, -a * w[0] / w[2], -b * w[0] / w[2]], [0, 0, 0, a, b, 1 / w[2], -a * w[1] / w[2], -b * w[1] / w[2]]]
          .map((row) => row.map((term) => root * term));
      });
      const step = leastSquares(columnsOf(rows), misfit);
      if (!step) return null;
      const next = h.map((v, i) => (i < 8 ? v + step[i] : v)), after = misfits(local, next);
      if (!after || !(square(after) < square(misfit))) break;
      h = next;
      misfit = after;
      if (Math.sqrt(square(step)) < 1e-13) break;
    }
    return h;
  }

  // A function from pixels to the map, null beyond the horizon, with about the ground size of a pixel in the middle; null
  // itself when the points do not determine it.
  function transform(pairs, weights, kind) {
    if (pairs.length < fewest[kind]) return null;
    const to = normalise(pairs, weights);
    if (!to) return null;
    let h = affine(to.local);
    if (h && kind === "projective") {
      const start = projective(to.local);
      h = start && refine(to.local, start);
    }
    if (!h) return null;
    const [a, b, c, d, e, f, g, i, j] = h;
    if (Math.abs(a * (e * j - f * i) - b * (d * j - f * g) + c * (d * i - e * g)) < RANK * RANK) return null;
    const apply = (x, y) => {
      const v = image(h, (x - to.x) / to.pixel, (y - to.y) / to.pixel);
      return v[2] > 0 ? [to.e + to.map * v[0] / v[2], to.n + to.map * v[1] / v[2]] : null;
    };
    return { apply, scale: to.map / to.pixel * Math.sqrt(Math.abs(a * e - b * d)) };
  }

  const residual = (apply, pair) => {
    const at = apply(pair.x, pair.y);
    return at && [pair.e - at[0], pair.n - at[1]];
  };
  const rms = (residuals) => Math.sqrt(sum(residuals.map((r) => r[0] * r[0] + r[1] * r[1])) / residuals.length);

  // `pairs` as Fit.solve takes them. Null when the points do not determine the transform.
  function fit(pairs, kind) {
    const through = (weights) => {
      const found = transform(pairs, weights, kind), residuals = found && pairs.map((p) => residual(found.apply, p));
      return residuals && !residuals.includes(null) ? { ...found, residuals } : null;
    };
    const equal = pairs.map(() => 1), first = through(equal);
    if (!first) return null;
    const squares = () => first.residuals.map((r) => r[0] * r[0] + r[1] * r[1]);
    const weights = Fit.weightsFrom(pairs, first.scale, 2 * fewest[kind], squares);
    const found = weights.every((w) => w === 1) ? first : through(weights);
    if (!found) return null;
    const { apply, residuals, scale } = found;
    const others = pairs.map((p, i) => {
      const rest = (values) => values.filter((_, k) => k !== i), without = transform(rest(pairs), rest(weights), kind);
      return without && residual(without.apply, p);
    });
    const leftOut = others.includes(null) ? null : others, axis = (k) => Math.sqrt(sum(residuals.map((r) => r[k] * r[k])) / residuals.length);
    const origin = apply(0, 0), right = apply(ARM, 0), down = apply(0, ARM);
    const geotransform = kind === "affine"
      ? [origin[0], (right[0] - origin[0]) / ARM, (down[0] - origin[0]) / ARM, origin[1], (right[1] - origin[1]) / ARM, (down[1] - origin[1]) / ARM] : null;
    return { kind, apply, weights, residuals, own: kind === "affine" ? own(pairs, weights, residuals, scale) : null, rmse: rms(residuals), rmseE: axis(0), rmseN: axis(1), leftOut, leftOutRmse: leftOut && rms(leftOut), geotransform };
  }

  // Of each point the weight and what the affine fit shows of it: its leverage is w·r·N⁻¹·rᵀ with r = (u, v, 1). Nothing is shown
  // where nothing is redundant.
  function own(pairs, weights, residuals, scale) {
    const freedom = 2 * pairs.length - 2 * fewest.affine;
    if (freedom <= 0) return pairs.map((_, k) => ({ weight: weights[k], redundancy: null, detectable: null, misfit: false }));
    const weighted = sum(residuals.map((r, k) => weights[k] * (r[0] * r[0] + r[1] * r[1])));
    const noise = { points: pairs.length, freedom, weighted, sigma0: Math.sqrt(weighted / freedom), scale };
    const local = normalise(pairs, weights).local.map((p) => ({ ...p, row: [p.u, p.v, 1] }));
    const at = (i, j) => sum(local.map((p, k) => weights[k] * p.row[i] * p.row[j]));
    const [a, b, c, e, f, i] = [at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)];
    const minors = [[e * i - f * f, c * f - b * i, b * f - c * e], [c * f - b * i, a * i - c * c, b * c - a * f], [b * f - c * e, b * c - a * f, a * e - b * b]];
    const determinant = a * minors[0][0] + b * minors[0][1] + c * minors[0][2];
    const cofactor = (row) => sum(row.map((v, k) => v * sum(row.map((w, l) => w * minors[k][l])))) / determinant;
    return local.map((p, k) => ({ weight: weights[k], ...Fit.reliability(noise, weights[k], weights[k] * cofactor(p.row), residuals[k]) }));
  }

  // Standard deviation of a coordinate of unit weight; 0 when nothing is left over.
  function sigma0(fit) {
    const freedom = 2 * fit.residuals.length - 2 * fewest[fit.kind];
    return freedom > 0 ? Math.sqrt(sum(fit.residuals.map((r, k) => fit.weights[k] * (r[0] * r[0] + r[1] * r[1]))) / freedom) : 0;
  }

  return { fit, sigma0 };
})();
