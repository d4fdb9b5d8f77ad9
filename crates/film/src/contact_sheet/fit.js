"use strict";
// The fit that the program makes of the marks in use (crates/film/src/interior.rs), so that the page shows what a replay gives.
const Fit = (() => {
  // Two and three marks: similarity; four of a projective: affine, since nothing else would be checked.
  const model = (wanted, n) => n < 2 ? null : n < 4 ? "similarity" : wanted === "projective" && n === 4 ? "affine" : wanted;

  // Gaussian elimination with partial pivoting; null when singular.
  function solve(a, b) {
    const n = b.length;
    for (let k = 0; k < n; k++) {
      let p = k;
      for (let i = k + 1; i < n; i++) if (Math.abs(a[i][k]) > Math.abs(a[p][k])) p = i;
      if (!(Math.abs(a[p][k]) > 1e-14)) return null;
      [a[k], a[p]] = [a[p], a[k]]; [b[k], b[p]] = [b[p], b[k]];
      for (let i = k + 1; i < n; i++) {
        const f = a[i][k] / a[k][k];
        for (let j = k; j < n; j++) a[i][j] -= f * a[k][j];
        b[i] -= f * b[k];
      }
    }
    for (let i = n - 1; i >= 0; i--) {
      for (let j = i + 1; j < n; j++) b[i] -= a[i][j] * b[j];
      b[i] /= a[i][i];
    }
    return b;
  }

  // Normal equations of rows of [coefficients, right side].
  function least(rows, n) {
    const a = Array.from({ length: n }, () => new Array(n).fill(0)), b = new Array(n).fill(0);
    for (const [c, r] of rows) for (let i = 0; i < n; i++) { b[i] += c[i] * r; for (let j = 0; j < n; j++) a[i][j] += c[i] * c[j]; }
    return solve(a, b);
  }

  // Marks {x, y (pixels), X, Y (mm)}; flip: the image and the camera's axes have opposite senses of rotation.
  // Gives {model, apply(x, y) → [X, Y], rmse_um} or null. Coordinates are about the centroids, in units of the spread.
  function fit(marks, wanted, flip) {
    const n = marks.length, kind = model(wanted, n);
    if (!kind) return null;
    const mean = g => marks.reduce((s, q) => s + g(q), 0) / n;
    const x0 = mean(q => q.x), y0 = mean(q => q.y), X0 = mean(q => q.X), Y0 = mean(q => q.Y);
    const u = Math.sqrt(mean(q => (q.x - x0) ** 2 + (q.y - y0) ** 2)), U = Math.sqrt(mean(q => (q.X - X0) ** 2 + (q.Y - Y0) ** 2));
    if (!(u > 0 && U > 0)) return null;
    const p = marks.map(q => ({ x: (q.x - x0) / u, y: (q.y - y0) / u, X: (q.X - X0) / U, Y: (q.Y - Y0) / U }));
    let h;
    if (kind === "similarity") {
      const s = flip ? -1 : 1, S = g => p.reduce((t, q) => t + g(q), 0), q = S(e => e.x * e.x + e.y * e.y);
      const a = S(e => e.x * e.X + s * e.y * e.Y) / q, b = S(e => e.y * e.X - s * e.x * e.Y) / q;
      h = [a, b, 0, -s * b, s * a, 0, 0, 0];
    } else {
      const X = least(p.map(e => [[e.x, e.y, 1], e.X]), 3), Y = least(p.map(e => [[e.x, e.y, 1], e.Y]), 3);
      if (!X || !Y) return null;
      h = [...X, ...Y, 0, 0];
      // Gauss–Newton of the residuals on the film.
      for (let k = 0; kind === "projective" && k < 100; k++) {
        const rows = [];
        for (const e of p) {
          const w = h[6] * e.x + h[7] * e.y + 1, A = (h[0] * e.x + h[1] * e.y + h[2]) / w, B = (h[3] * e.x + h[4] * e.y + h[5]) / w;
          if (!(w > 0)) return null;
          rows.push([[e.x / w, e.y / w, 1 / w, 0, 0, 0, -A * e.x / w, -A * e.y / w], e.X - A]);
          rows.push([[0, 0, 0, e.x / w, e.y / w, 1 / w, -B * e.x / w, -B * e.y / w], e.Y - B]);
        }
        const d = least(rows, 8);
        if (!d) return null;
        h = h.map((v, i) => v + d[i]);
        if (Math.hypot(...d) < 1e-15) break;
      }
    }
    const apply = (x, y) => {
      const a = (x - x0) / u, b = (y - y0) / u, w = h[6] * a + h[7] * b + 1;
      return [X0 + U * (h[0] * a + h[1] * b + h[2]) / w, Y0 + U * (h[3] * a + h[4] * b + h[5]) / w];
    };
    const square = mean(q => { const [A, B] = apply(q.x, q.y); return (A - q.X) ** 2 + (B - q.Y) ** 2; });
    return { model: kind, apply, rmse_um: 1e3 * Math.sqrt(square) };
  }
  return { fit };
})();
