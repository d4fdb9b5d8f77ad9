// What a review changes, apart from how it looks. The rules are those of src/review/replay.rs.
const Review = (() => {
  // The marks as the run left them; those of a refused run are proposals until somebody accepts them.
  const initial = (points) => points.map((p) => (p.mark ? { mark: p.mark, used: p.state === "found", verdict: null } : null));

  function choices(point) {
    const own = point.mark && point.mark.candidate !== null ? [point.mark] : [];
    return own.concat(point.proposals);
  }

  function applied(points, held, edit, handVariance) {
    const i = points.findIndex((p) => p.name === edit.gcp), now = held[i], next = held.slice();
    switch (edit.action) {
      case "accept": next[i] = { ...now, used: true, verdict: "accepted" }; break;
      case "reject": next[i] = { ...(now || { mark: null }), used: false, verdict: "rejected" }; break;
      case "not-visible": next[i] = { ...(now || { mark: null }), used: false, verdict: "not-visible" }; break;
      case "move": {
        const chip = now && now.mark ? now.mark.chip : points[i].chip;
        const mark = { x: edit.x, y: edit.y, covariance_px2: [handVariance, 0, handVariance], score: null,
          found_by: "review", candidate: null, size_px: null, chip };
        next[i] = { mark, used: true, verdict: "moved" };
        break;
      }
      case "pick": {
        const mark = choices(points[i]).find((m) => m.candidate === edit.candidate);
        next[i] = { mark, used: true, verdict: "picked" };
        break;
      }
    }
    return next;
  }

  function replayed(points, edits, handVariance) {
    return edits.reduce((held, edit) => applied(points, held, edit, handVariance), initial(points));
  }

  // The fit of what is held, and what is known of every point then.
  function evaluate(points, held) {
    const control = [], pairs = [];
    points.forEach((p, i) => {
      if (held[i] && held[i].used && p.role === "control") {
        const m = held[i].mark;
        control.push(i);
        pairs.push({ x: m.x, y: m.y, covariance: m.covariance_px2, e: p.easting, n: p.northing, sigma: p.sigma_m });
      }
    });
    const solution = Fit.solve(pairs), rows = points.map(() => null);
    if (solution) {
      control.forEach((i, k) => { rows[i] = solution.rows[k]; });
      points.forEach((p, i) => {
        if (held[i] && held[i].used && p.role === "check") {
          const [e, n] = Fit.apply(solution.similarity, held[i].mark.x, held[i].mark.y);
          const de = p.easting - e, dn = p.northing - n, l = Math.sqrt(de * de + dn * dn);
          rows[i] = { e: de, n: dn, length: l, px: l / solution.scale, weight: null, redundancy: null, leaveOneOut: null,
            detectable: null, outlier: false };
        }
      });
    }
    const checks = points.map((p, i) => (p.role === "check" ? rows[i] : null)).filter((r) => r);
    const checkRmse = checks.length ? Math.sqrt(checks.reduce((s, r) => s + r.e * r.e + r.n * r.n, 0) / checks.length) : null;
    return { solution, rows, control: control.length, checks: checks.length, checkRmse };
  }

  // Nudges of one mark in a row are one move.
  function compact(edits) {
    const out = [];
    for (const edit of edits) {
      const last = out[out.length - 1];
      if (last && last.action === "move" && edit.action === "move" && last.gcp === edit.gcp) out.pop();
      out.push(edit);
    }
    return out;
  }

  function patch(source, edits, state) {
    const s = state.solution;
    return {
      schema: "autoref-stream-patch", schema_version: 1, for: "gcps", source, edits: compact(edits),
      shown: { points: state.control, rmse_m: s ? s.rmse : null, geotransform: s ? Fit.geotransform(s.similarity) : null },
    };
  }

  return { initial, choices, applied, replayed, evaluate, patch };
})();
