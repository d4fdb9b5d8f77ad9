// What a review changes, apart from how it looks. The rules are those of src/review/replay.rs.
const Review = (() => {
  // Less is no misfit: src/result/misfit.rs.
  const LEAST_MISFIT_PX = 2;

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

  // The fit of what is held, and what is known of every point then. `model` names the transform that the run chose beside the
  // similarity, if any: an affine one stands in its place (`fit` and the rows), a projective one is reported beside it.
  // `mirrored`: the run found the image to be.
  function evaluate(points, held, model, mirrored) {
    const control = [], pairs = [];
    points.forEach((p, i) => {
      if (held[i] && held[i].used && p.role === "control") {
        const m = held[i].mark;
        control.push(i);
        pairs.push({ x: m.x, y: m.y, covariance: m.covariance_px2, e: p.easting, n: p.northing, sigma: p.sigma_m });
      }
    });
    const solution = Fit.solve(pairs, mirrored), rows = points.map(() => null);
    const chosen = solution && (model === "affine" || model === "projective") ? Planar.fit(pairs, model) : null;
    const written = chosen && model === "affine" ? chosen : null;
    const place = written ? written.apply : solution && ((x, y) => Fit.apply(solution.similarity, x, y));
    const fit = solution && { rmse: solution.rmse, rmseE: solution.rmseE, rmseN: solution.rmseN, rmsePx: solution.rmsePx,
      geotransform: Fit.geotransform(solution.similarity) };
    if (written) {
      Object.assign(fit, { rmse: written.rmse, rmseE: written.rmseE, rmseN: written.rmseN, rmsePx: written.rmse / solution.scale,
        geotransform: written.geotransform });
    }
    if (solution) {
      control.forEach((i, k) => {
        rows[i] = solution.rows[k];
        if (written) {
          const [e, n] = written.residuals[k], l = Math.sqrt(e * e + n * n), out = written.leftOut && written.leftOut[k];
          const { weight, redundancy, detectable, misfit } = written.own[k];
          rows[i] = { e, n, length: l, px: l / solution.scale, weight, redundancy, detectable, outlier: misfit, leaveOneOut: out && Math.sqrt(out[0] * out[0] + out[1] * out[1]) };
        }
      });
      points.forEach((p, i) => {
        if (held[i] && held[i].used && p.role === "check") {
          const [e, n] = place(held[i].mark.x, held[i].mark.y);
          const de = p.easting - e, dn = p.northing - n, l = Math.sqrt(de * de + dn * dn);
          rows[i] = { e: de, n: dn, length: l, px: l / solution.scale, weight: null, redundancy: null, leaveOneOut: null,
            detectable: null, outlier: false };
        }
      });
    }
    flagFar(rows.filter((r, i) => r && points[i].role === "check"));
    const checks = points.map((p, i) => (p.role === "check" ? rows[i] : null)).filter((r) => r);
    const checkRmse = checks.length ? Math.sqrt(checks.reduce((s, r) => s + r.e * r.e + r.n * r.n, 0) / checks.length) : null;
    return { solution, fit, chosen, rows, control: control.length, checks: checks.length, checkRmse };
  }

  // Check points that are much farther off than the others: `flag_far` of the program.
  function flagFar(checks) {
    if (!checks.length) return;
    const lengths = checks.map((r) => r.px).sort((a, b) => a - b), half = lengths[Math.floor((lengths.length - 1) / 2)];
    const limit = Math.max(4.5 * half / 1.1774, LEAST_MISFIT_PX);
    checks.forEach((r) => { r.outlier = r.px > limit; });
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
    const f = state.fit;
    return {
      schema: "autoref-stream-patch", schema_version: 1, for: "gcps", source, edits: compact(edits),
      shown: { points: state.control, rmse_m: f ? f.rmse : null, geotransform: f ? f.geotransform : null },
    };
  }

  // A name as a shell takes it for one word.
  const quoted = (name) => (/^[\w.\/+:@%,=-]+$/.test(name) && !name.startsWith("-") ? name : name.startsWith("-") ? quoted(`./${name}`) : `'${name.replace(/'/g, "'\\''")}'`);
  const beside = (source, ending) => source.replace(/(\.autoref)?\.json$/, "") + ending;
  // How the patch is replayed, and how what that gives is written where the run wrote: `kinds` as `--write` had them,
  // `apart` in another folder than the image's.
  function commands(source, kinds, apart) {
    const reviewed = quoted(beside(source, ".reviewed.json")), write = kinds && kinds.length ? ` --write ${kinds.join(",")}` : "";
    return ` Changes made in it are saved as a patch. Its replay: autoref-stream solve ${quoted(source)} --patch ${quoted(beside(source, ".patch.json"))} -o ${reviewed}`
      + ` and then, since that changes no georeference: autoref-stream apply ${reviewed}${write}${apart ? " --out ." : ""} --overwrite`;
  }

  return { initial, choices, applied, replayed, evaluate, patch, beside, commands };
})();
