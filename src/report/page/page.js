// The page itself: state, drawing of all parts, and the keyboard.
(() => {
  const { svg, html, metres, ground, pixels, fixed, superscript, grouped, nice, rounded, brief } = Draw;
  const D = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const replace = (id, ...children) => byId(id).replaceChildren(...children.filter((c) => c !== null && c !== undefined));
  const STATES = { found: "in the fit", check: "check point", "not-found": "not found", outside: "outside the image",
    proposed: "proposed", unknown: "not placed", rejected: "rejected", "not-visible": "not visible" };

  const MODEL = D.chosen_model ? D.chosen_model.model : null;
  const MIRRORED = Boolean(D.similarity && D.similarity.mirrored);
  let edits = [], saved = "[]", notes = new Map(), held = Review.initial(D.points), state = Review.evaluate(D.points, held, MODEL, MIRRORED), selected = 0, order = [];
  const start = state;

  // ---- words
  function stateOf(i) {
    const h = held[i], p = D.points[i];
    if (h && h.used) return p.role === "check" ? "check" : "found";
    if (h && (h.verdict === "rejected" || h.verdict === "not-visible")) return h.verdict;
    if (offered(i)) return "proposed";
    return p.state === "found" ? "rejected" : p.state;
  }
  // The candidate next to where a point must be that the run did not take.
  function offered(i) {
    const h = held[i], p = D.points[i];
    return p.state === "not-found" && !(h && h.mark) && p.proposals.length ? p.proposals[0] : null;
  }
  // Of a point that was not found: the first word of why.
  const because = (i) => (stateOf(i) === "not-found" && D.points[i].why ? `, ${D.points[i].why.split(":")[0]}` : "");
  // What the symbol on the overview is.
  const symbolOf = (s) => ({ rejected: "not-found", "not-visible": "not-found", unknown: null }[s] === undefined ? s
    : { rejected: "not-found", "not-visible": "not-found", unknown: null }[s]);
  function chance(log10) {
    if (log10 === null) return "–";
    if (log10 > -2) return `${Number(Math.pow(10, log10).toPrecision(2))} expected`;
    if (log10 > -6) return `1 in ${Math.floor(Math.pow(10, -log10) / 10) * 10}`;
    return `1 in 10${superscript(Math.floor(-log10))}`;
  }
  const transform = () => (state.solution ? state.solution.similarity : D.similarity);
  const count = (n, one, many) => `${n} ${n === 1 ? one : many}`;

  // ---- head
  function head() {
    document.title = `${D.image.name}: georeference report`;
    byId("title").textContent = D.image.name;
    byId("subtitle").textContent = [`${D.image.width} × ${D.image.height} px`, D.image.description,
      `points of ${D.gcp_file.split("/").pop()}`, D.crs, D.made].filter(Boolean).join(" · ");
    const verdict = byId("verdict"), edited = edits.length > 0;
    verdict.className = `verdict ${edited ? "open" : D.status}`;
    verdict.replaceChildren();
    document.body.classList.toggle("edited", edited);
    if (D.status === "solved" && edited) {
      verdict.append(`Fit of ${count(state.control, "point", "points")} with the changes made here`,
        html("p", { class: "sub" }, "The replay judges this fit by its residuals and its points; the chance of a false alarm stays that of the run's pattern."));
    } else if (D.status === "solved") {
      verdict.append(`Georeferenced from ${count(state.control, "point", "points")}`);
    } else {
      verdict.append(`Not georeferenced: ${D.reason || "no reason given"}`);
      if (edits.length && state.solution) {
        const leave = D.advice.some((a) => a.includes("--force")) ? ", unless solve is given the --force that is named here, too" : "";
        verdict.append(html("p", { class: "sub" }, `With what was accepted here there is a fit of ${count(state.control, "point", "points")}; ${D.condemned
          ? `the mistake in the list stays, and the replay is refused for it${leave}.` : "replay the patch to have it."}`));
      }
      if (D.advice.length) verdict.append(html("ul", {}, ...D.advice.map((a) => html("li", {}, a))));
    }
    const s = state.solution, f = state.fit, items = [];
    const add = (name, value, more) => items.push(html("div", {}, html("dt", {}, name), html("dd", {}, value, more ? html("small", {}, more) : null)));
    const used = state.control + state.checks;
    const missing = D.points.filter((p, i) => ["not-found", "rejected", "not-visible", "proposed"].includes(stateOf(i))).length;
    const placed = D.points.some((p) => p.state !== "unknown") || used > 0;
    add("Points found", placed ? `${used} of ${used + missing}` : "none", !placed ? `${D.points.length} listed` : `${D.points.length} listed, ${D.points.filter((p) => p.state === "outside").length} outside the image`);
    if (s) {
      add("RMSE of the fit", ground(f.rmse), `E ${ground(f.rmseE)}, N ${ground(f.rmseN)}; ${pixels(f.rmsePx)} px`);
      if (MODEL) add(`Transform: ${MODEL === "affine" && !state.chosen ? "similarity" : MODEL}`, state.chosen ? ground(state.chosen.rmse) : MODEL === "7-parameter" ? ground(D.chosen_model.rmse_m) : "–",
        state.chosen ? `RMSE; similarity ${ground(s.rmse)}` : MODEL === "7-parameter" ? "RMSE in space, of the run" : `the points do not determine the ${MODEL} transform`);
      if (state.checks) add("RMSE of check points", ground(state.checkRmse), count(state.checks, "point kept out of the fit", "points kept out of the fit"));
      add("Pixel on the ground", `${(s.scale * 100).toFixed(3)} cm`, `turned ${Math.abs(s.rotation).toFixed(4)}° ${s.rotation < -5e-5 ? "clockwise" : "anticlockwise"} from east`);
    }
    if (D.log10_false_alarms !== null) add("False alarms", chance(D.log10_false_alarms), edited ? "of the run's pattern, before the changes made here" : D.status === "solved"
      ? "that so many marks agree without being the points" : "such patterns in this image by chance alone");
    replace("figures", ...items);
    const note = byId("reviewed");
    note.hidden = !edits.length && !D.patch;
    if (edits.length) {
      const was = start.solution ? ` RMSE was ${ground(start.fit.rmse)} from ${count(start.control, "point", "points")}.` : "";
      note.textContent = `Shown with ${count(edits.length, "change", "changes")} by review, ${unsaved() ? "not saved yet" : "saved"}.${was}`;
    } else if (D.patch) {
      note.textContent = `${count(D.patch.edits.length, "change", "changes")} by review were replayed.`;
    }
  }
  // Stands above what is as the run said it, and is seen once something is changed.
  const ofRun = (more = "") => html("p", { class: "of-run" }, `As the run found it, before the changes made here.${more}`);
  function warnings() {
    if (D.warnings.length) replace("warnings", ofRun(" The replay judges the new fit, and tells mistakes in the list again."), html("ul", { class: "warnings", "aria-label": "Warnings" }, ...D.warnings.map((w) => html("li", {}, w))));
  }

  // ---- overview and expected error
  // Drawings have letters of one size whatever their own; on paper they are as wide as a page.
  let onPaper = false;
  const shownSize = () => (onPaper ? [700, 397] : [byId("overview").clientWidth || 1136, 980]);
  // Where a point stands in the image: its mark, or where the transform has it; null without either.
  function placeOf(p, i, s) {
    const kind = symbolOf(stateOf(i)), h = held[i];
    if (!kind) return null;
    if (h && h.used) return [h.mark.x, h.mark.y];
    return kind === "proposed" && p.mark ? [p.mark.x, p.mark.y] : s ? Fit.invert(s, p.easting, p.northing) : null;
  }

  let showCandidates = false;
  function overview() {
    const anyOutside = D.points.some((p) => p.state === "outside"), s = transform();
    const drawing = Sketch.frame(D.overview, shownSize(), anyOutside, Boolean(s)), { box, u, W, H } = drawing, f = W / D.image.width;
    box.setAttribute("aria-label", `The image with ${count(D.points.length, "point", "points")} and residual vectors.`);
    if (showCandidates) {
      for (const [x, y] of D.candidates.dots) box.append(svg("circle", { class: "candidate", cx: x * f, cy: y * f, r: 2.6 * u, fill: "none", stroke: "#fff", "stroke-width": 1.2 * u }));
    }
    const places = D.points.map((p, i) => placeOf(p, i, s)), symbols = places.filter(Boolean).map(([x, y]) => [x * f, y * f]);
    const lengths = [], taken = [];
    const longest = Math.max(...state.rows.map((r) => (r ? r.length : 0)), 0);
    let enlarged = null;
    if (s) {
      const scale = Math.sqrt(s.a_re * s.a_re + s.a_im * s.a_im) / f;
      lengths.push(Sketch.ruler(u, scale));
      taken.push(Sketch.north(drawing, s, symbols));
      if (longest > 0) {
        // The longest is legible, and the others still are when one is far longer. Residuals below a pixel have shorter
        // arrows than a bad fit.
        const sorted = state.rows.filter((r) => r).map((r) => r.length).sort((a, b) => a - b);
        const middle = Math.max(sorted[Math.floor(sorted.length / 2)], 1e-9);
        const alarm = Math.min(Math.max(longest / (scale * f), 0.35), 1);
        const perMetre = alarm * Math.min(150 / longest, Math.max(58 / longest, 20 / middle)) * u, unit = nice(Math.min(longest, 70 * u / perMetre));
        enlarged = perMetre * scale;
        lengths.push([unit * perMetre, `arrows: ${rounded(unit)}`]);
      }
      Sketch.bars(drawing, lengths);
    }
    const labels = svg("g", {}), names = Sketch.labelPlaces(drawing, symbols, taken);
    D.points.forEach((p, i) => {
      const kind = symbolOf(stateOf(i)), at = places[i];
      if (!at) return;
      let x = at[0] * f, y = at[1] * f;
      if (kind === "outside") {
        x = Math.min(Math.max(x, -16 * u), W + 16 * u);
        y = Math.min(Math.max(y, -16 * u), H + 16 * u);
      }
      const row = state.rows[i];
      if (row && enlarged) {
        const [dx, dy] = Sketch.onImage(s, row.e, row.n, f).map((v) => v * enlarged);
        const line = (colour, w) => svg("line", { class: "vector", x1: x, y1: y, x2: x + dx, y2: y + dy, stroke: colour, "stroke-width": w * u, "stroke-linecap": "round" });
        box.append(line("#fff", 5), line(p.role === "check" ? "#6a3fa0" : row.outlier ? "#ae2a1f" : "#b3480a", 2.4));
      }
      box.append(Draw.symbol(kind, (kind === "outside" ? 5 : 6.5) * u, x, y));
      if (kind !== "outside" || D.points.length <= 60) {
        const place = names(x, y, brief(p.name));
        if (place) {
          labels.append(svg("text", { class: "halo", x: place.x, y: place.y, "text-anchor": place.anchor, "font-size": 12.5 * u, style: `stroke-width:${3 * u}px` }, brief(p.name)));
        }
      }
    });
    box.append(labels);
    const kinds = new Set(D.points.map((p, i) => symbolOf(stateOf(i))));
    const words = { found: "matched", check: "check point", "not-found": "not found", outside: "outside the image", proposed: "proposed: seen, not taken" };
    const toggle = html("input", { type: "checkbox", id: "dots" });
    toggle.checked = showCandidates;
    toggle.addEventListener("change", () => { showCandidates = toggle.checked; overview(); byId("dots").focus(); });
    const legend = html("div", { class: "legend" }, ...Object.keys(words).filter((k) => kinds.has(k)).map((k) => Draw.legendItem(k, words[k])),
      enlarged ? html("span", {}, `Arrows point from the mark to the surveyed place, enlarged ${grouped(Number(enlarged.toPrecision(3)))} times; the bar below the picture shows their scale.`) : null,
      !state.solution && s ? html("span", {}, "No fit was believed: points stand where the likeliest one would have them.") : null,
      html("label", { class: "noprint" }, toggle, ` all ${D.candidates.total} candidates`));
    byId("overview-figure").setAttribute("aria-label", "Overview of the image");
    replace("overview-figure", box, legend);
  }

  function expected() {
    const radius = Fit.radius95(state.solution), section = byId("expected");
    section.hidden = !state.solution;
    if (!state.solution) return;
    if (!radius) {
      byId("expected-note").textContent = "With two points nothing is redundant: the fit says nothing of its own error.";
      byId("expected-figure").replaceChildren();
      return;
    }
    const drawing = Sketch.frame(D.overview, shownSize(), false, true), { box, u, W, H } = drawing, f = W / D.image.width;
    const c = state.solution.centre, cx = c.x * f, cy = c.y * f;
    const corners = [[0, 0], [W, 0], [W, H], [0, H]].map(([x, y]) => Math.hypot(x - cx, y - cy));
    const far = Math.max(...corners), inside = cx >= 0 && cy >= 0 && cx <= W && cy <= H;
    const nearest = inside ? 0 : Math.hypot(cx - Math.min(Math.max(cx, 0), W), cy - Math.min(Math.max(cy, 0), H));
    const low = radius.at(nearest / f), high = radius.at(far / f);
    // From pale yellow to dark purple, darker is worse; by the share of the way from the best to the worst.
    const ramp = [[255, 247, 188], [254, 196, 79], [236, 112, 20], [153, 52, 84], [70, 18, 92]];
    const colour = (t) => {
      const k = Math.min(Math.max(t, 0), 1) * (ramp.length - 1), i = Math.min(Math.floor(k), ramp.length - 2), w = k - i;
      return `rgb(${ramp[i].map((v, j) => Math.round(v * (1 - w) + ramp[i + 1][j] * w)).join(",")})`;
    };
    const share = (r) => (high > low ? (r - low) / (high - low) : 0);
    const gradient = svg("radialGradient", { id: "error-ramp", gradientUnits: "userSpaceOnUse", cx, cy, r: far });
    for (let k = 0; k <= 24; k++) gradient.append(svg("stop", { offset: `${k / 24 * 100}%`, "stop-color": colour(share(radius.at(far * k / 24 / f))) }));
    const clip = svg("clipPath", { id: "error-clip" }, svg("rect", { width: W, height: H }));
    box.append(svg("defs", {}, gradient, clip), svg("rect", { width: W, height: H, fill: "url(#error-ramp)", opacity: 0.62 }));
    const lines = svg("g", { "clip-path": "url(#error-clip)" });
    const step = nice(Math.max((high - low) / 3, low / 50));
    const values = [];
    for (let k = Math.floor(low / step) + 1; k * step < high; k++) values.push(k * step);
    for (const v of values) {
      const d = radius.distance(v) * f;
      lines.append(svg("circle", { cx, cy, r: d, fill: "none", stroke: "#1b2530", "stroke-opacity": 0.6, "stroke-width": 1.1 * u }));
      // A label where the circle is well inside the image.
      for (const angle of [-0.4, 0.6, 2.2, 3.6, 4.7, 1.57, 3.14, 0, 5.5]) {
        const x = cx + d * Math.cos(angle), y = cy + d * Math.sin(angle);
        if (x > 40 * u && x < W - 40 * u && y > 20 * u && y < H - 20 * u) {
          lines.append(svg("text", { class: "halo", x, y: y + 4 * u, "text-anchor": "middle", "font-size": 12 * u, style: `stroke-width:${3.4 * u}px` }, rounded(v)));
          break;
        }
      }
    }
    box.append(lines);
    D.points.forEach((p, i) => {
      if (held[i] && held[i].used && p.role === "control") box.append(Draw.symbol("found", 5 * u, held[i].mark.x * f, held[i].mark.y * f));
    });
    const s = state.solution.similarity, used = D.points.map((p, i) => (held[i] && held[i].used ? held[i].mark : null)).filter(Boolean);
    Sketch.bars(drawing, [Sketch.ruler(u, Math.sqrt(s.a_re * s.a_re + s.a_im * s.a_im) / f)]);
    Sketch.north(drawing, s, used.map((m) => [m.x * f, m.y * f]));
    byId("expected-figure").setAttribute("aria-label", "Map of the expected error");
    box.setAttribute("aria-label", `Expected error over the image, from ${ground(low)} to ${ground(high)}.`);
    const scaleBar = svg("svg", { viewBox: "0 0 160 12", style: "width:160px;height:12px", "aria-hidden": "true" });
    for (let k = 0; k < 40; k++) scaleBar.append(svg("rect", { x: k * 4, width: 4.2, height: 12, fill: colour(k / 39), "fill-opacity": 0.8 }));
    byId("expected-note").textContent = `The transform puts 95 of 100 places within this distance of where they are: ${ground(low)} at best, ${ground(high)} in the worst corner. `
      + `It follows from the covariance of the fit alone with ${state.solution.freedom} redundant measurements. A single point read off the image adds the scatter of the marks themselves: ${ground(radius.point(nearest / f))} to ${ground(radius.point(far / f))}.`
      + (MODEL === "affine" ? " Counted for the similarity; the affine transform that was written has two parameters more and is known less well, the more so the less alike the accuracies of the points are: the corners' expected errors in the summary and the JSON are its own." : "")
      + (edits.length ? " What a fit that does not suit its points adds to it is told by the replay." : D.misfit ? ` This map does not know what was said of the fit: ${D.misfit}. The corners' expected errors in the summary and the JSON count it.` : "");
    replace("expected-figure", box, html("div", { class: "legend" }, html("span", {}, ground(low), scaleBar, ground(high)), Draw.legendItem("found", "point of the fit")));
  }

  // ---- plots
  function plots() {
    byId("residuals").hidden = !state.solution;
    if (!state.solution) return;
    const middle = Fit.apply(state.solution.similarity, D.image.width / 2, D.image.height / 2);
    const items = [], affine = MODEL === "affine" ? state.chosen : null;
    D.points.forEach((p, i) => {
      const r = state.rows[i];
      if (r) items.push({ name: p.name, e: r.e, n: r.n, length: r.length, weight: r.weight, redundancy: r.redundancy, check: p.role === "check",
        distance: Math.hypot(p.easting - middle[0], p.northing - middle[1]) });
    });
    const sigma0 = affine ? Planar.sigma0(affine) : state.solution.sigma0;
    const s0 = sigma0 > 0 ? sigma0 : null;
    replace("plots", Draw.vectors(items, s0), Draw.histogram(items, s0), Draw.distance(items), s0 ? Draw.quantiles(items, s0) : null);
  }

  // ---- table
  let sortKey = null, descending = false;
  const shown = (i) => { const h = held[i]; return h && h.mark && (h.used || stateOf(i) === "proposed") ? h.mark : null; };
  const columns = [
    ["Point", "text", (i) => D.points[i].name, (v) => v],
    ["State", "text", (i) => STATES[stateOf(i)], null],
    ["x px", "", (i) => { const m = shown(i); return m && m.x; }, pixels],
    ["y px", "", (i) => { const m = shown(i); return m && m.y; }, pixels],
    ["dE", "ground", (i) => state.rows[i] && state.rows[i].e, null],
    ["dN", "ground", (i) => state.rows[i] && state.rows[i].n, null],
    ["Residual", "ground", (i) => state.rows[i] && state.rows[i].length, null],
    ["px", "", (i) => state.rows[i] && state.rows[i].px, pixels],
    ["Left out", "ground", (i) => state.rows[i] && state.rows[i].leaveOneOut, null],
    ["Redundancy", "", (i) => state.rows[i] && state.rows[i].redundancy, pixels],
    ["Detectable", "ground", (i) => state.rows[i] && state.rows[i].detectable, null],
    ["Weight", "", (i) => state.rows[i] && state.rows[i].weight, pixels],
    ["Score", "", (i) => { const m = shown(i); return m && m.score; }, (v) => (v === null || v === undefined ? "–" : v.toFixed(1))],
    ["Found by", "text", (i) => { const m = shown(i); return m ? m.found_by : "–"; }, (v) => v],
  ];
  function table() {
    const rows = D.points.map((p, i) => i);
    // One unit for the whole table: millimetres while all residuals are below a metre.
    const small = state.rows.every((r) => !r || r.length < 1), unit = small ? "mm" : "m";
    const inUnit = (v) => (small && v !== null && v !== undefined ? fixed(1000 * v, 1) : metres(v));
    if (sortKey !== null) {
      const value = columns[sortKey][2], sign = descending ? -1 : 1;
      rows.sort((a, b) => {
        const x = value(a), y = value(b), none = (v) => v === null || v === undefined;
        if (none(x) || none(y)) return none(x) - none(y);
        return sign * (typeof x === "string" ? x.localeCompare(y, "en", { numeric: true }) : Math.abs(x) - Math.abs(y));
      });
    }
    const headers = columns.map(([title, kind], k) => {
      const name = kind === "ground" ? `${title} ${unit}` : title;
      const button = html("button", { type: "button", "aria-label": `${name}, sort` }, name);
      button.addEventListener("click", () => {
        descending = sortKey === k ? !descending : kind !== "text";
        sortKey = k;
        table();
        byId("points-table").querySelectorAll("th button")[k].focus();
      });
      return html("th", { scope: "col", class: kind === "text" ? kind : null, "aria-sort": sortKey === k ? (descending ? "descending" : "ascending") : "none" }, button);
    });
    const body = rows.map((i) => {
      const r = state.rows[i], s = stateOf(i);
      return html("tr", { class: r && r.outlier ? "outlier" : r ? null : "unused" }, ...columns.map(([, kind, value, show], k) => (k === 1
        ? html("td", { class: "text", title: s === "not-found" ? D.points[i].why : null }, html("span", { class: `state ${s}` }, STATES[s] + because(i)))
        : html("td", { class: kind === "text" ? kind : null, title: k === 0 ? D.points[i].name : null }, (kind === "ground" ? inUnit : show)(value(i))))));
    });
    replace("points-table", html("table", { "aria-label": "All points" }, html("thead", {}, html("tr", {}, ...headers)), html("tbody", {}, ...body)));
    byId("points-note").textContent = state.solution
      ? "Residuals are surveyed − computed. “Left out” is the error of the point when the fit is made without it; “detectable” is the smallest error of the point that a test would notice (Baarda, 0.1 % and 80 %); “score” says how sure a mark is one: 0 is even odds, 5 is 150 to 1. Choose a heading to sort."
      : "No transform was accepted, so there are no residuals. Choose a heading to sort.";
  }

  // ---- chips
  function chipBox(chip, marks, large) {
    const s = chip.side_px, box = svg("svg", { viewBox: `${chip.left} ${chip.top} ${s} ${s}`, "aria-hidden": "true" });
    box.append(svg("image", { class: "pixels", href: chip.src, x: chip.left, y: chip.top, width: s, height: s, preserveAspectRatio: "none" }));
    const u = s / (large ? 344 : 150);
    for (const m of marks) {
      const both = (draw) => box.append(draw("#000", 3.2 * u, 0.45), draw(m.colour, 1.5 * u, 1));
      if (m.outline) both((stroke, w, o) => svg("polygon", { points: m.outline.map((p) => p.join(",")).join(" "), fill: "none", stroke, "stroke-width": w, "stroke-opacity": o }));
      else if (m.size) both((stroke, w, o) => svg("rect", { x: m.x - m.size[0] / 2, y: m.y - m.size[1] / 2, width: m.size[0], height: m.size[1], fill: "none", stroke, "stroke-width": w, "stroke-opacity": o, "stroke-dasharray": `${4 * u} ${3 * u}` }));
      const a = (m.cross || 5) * u, b = (m.gap || 0) * u;
      both((stroke, w, o) => svg("path", { d: `M${m.x - a} ${m.y}H${m.x - b}M${m.x + b} ${m.y}H${m.x + a}M${m.x} ${m.y - a}V${m.y - b}M${m.x} ${m.y + b}V${m.y + a}`, stroke, "stroke-width": w, "stroke-opacity": o }));
    }
    return box;
  }
  const markOf = (i) => {
    const h = held[i], p = D.points[i];
    return h && h.mark && (h.used || p.state === "proposed" || p.state === "found") ? h.mark : null;
  };
  // Which window shows a point; null where the page has none.
  const chipIndex = (i) => {
    const mark = markOf(i), index = mark && mark.chip !== null ? mark.chip : D.points[i].chip;
    return index === undefined ? null : index;
  };
  // The picture of a point as it stands now.
  function chipOf(i, large) {
    const p = D.points[i], h = held[i], mark = markOf(i), index = chipIndex(i);
    if (index === null) return html("span", { class: "none" });
    const chip = D.chips[index], marks = [], s = transform();
    if (large || !mark) {
      for (const m of Review.choices(p)) {
        if (!mark || m.candidate !== mark.candidate) marks.push({ x: m.x, y: m.y, size: m.size_px, colour: "#ffd23f", cross: 3 });
      }
      if (s) {
        const [x, y] = Fit.invert(s, p.easting, p.northing);
        marks.push({ x, y, colour: "#7fd0ff", cross: 9, gap: 3 });
      }
    }
    if (mark) {
      // A mark moved by hand takes the outline of the fitted shape along.
      const from = mark.found_by !== "review" || mark.candidate !== null ? mark : p.mark, own = from && from.chip === mark.chip ? chip.outline : null;
      const outline = own ? own.map(([x, y]) => [x + mark.x - from.x, y + mark.y - from.y]) : null;
      marks.push({ x: mark.x, y: mark.y, outline, size: mark.size_px, colour: h.used ? "#fff" : "#ff9c8f", cross: large ? 9 : 5 });
    }
    return chipBox(chip, marks, large);
  }
  function facts(i) {
    const h = held[i], r = state.rows[i], p = D.points[i];
    const near = p.proposals.length ? `${count(p.proposals.length, "candidate", "candidates")} near` : "no candidate near";
    if (r) return [`${ground(r.length)} · ${pixels(r.px)} px`, h.mark.score === null ? (h.mark.candidate === null && h.verdict ? "placed by hand" : "no score") : `${h.mark.code ? `${h.mark.code} · ` : ""}score ${h.mark.score.toFixed(1)}`];
    if (p.why && !(h && h.mark)) return [p.why, near];
    return [h && h.mark && p.state === "proposed" ? `score ${h.mark.score === null ? "–" : h.mark.score.toFixed(1)}` : near, ""];
  }
  // Points whose window the page has no room for.
  const pictureless = () => order.filter((i) => chipIndex(i) === null).length;
  const shownAsCard = (i) => { const p = D.points[i]; return p.state !== "outside" && p.state !== "unknown"; };

  function cards() {
    order = D.points.map((p, i) => i).filter(shownAsCard);
    if (byId("order").value === "worst") {
      const badness = (i) => (state.rows[i] ? start.rows[i] ? start.rows[i].length : state.rows[i].length : Infinity);
      order.sort((a, b) => badness(b) - badness(a));
    }
    if (order.length && !order.includes(selected)) selected = order[0];
    const items = order.map((i) => {
      const p = D.points[i], s = stateOf(i), [one, two] = facts(i), h = held[i];
      const words = `${p.name}, ${STATES[s]}${h && h.verdict && h.verdict !== s ? `, ${h.verdict}` : ""}, ${one}${two ? `, ${two}` : ""}`;
      const button = html("button", { type: "button", class: `card${s === "rejected" || s === "not-visible" ? " off" : ""}`, "data-point": i,
        tabindex: i === selected ? 0 : -1, "aria-current": i === selected ? "true" : "false", "aria-label": words },
      chipOf(i, false), html("span", { class: "name" }, p.name), html("span", { class: `line state ${s}` }, STATES[s] + (h && h.verdict && h.used ? `, ${h.verdict}` : "")),
      html("span", { class: "line" }, one), html("span", { class: "line" }, two));
      button.addEventListener("click", () => select(i, true));
      button.addEventListener("focus", () => { if (selected !== i) select(i, false); });
      return html("li", {}, button);
    });
    const gallery = D.candidates.gallery.map((m, k) => html("li", {}, html("div", { class: "card" },
      m.chip === null ? null : chipBox(D.chips[m.chip], [{ x: m.x, y: m.y, outline: D.chips[m.chip].outline, size: m.size_px, colour: "#fff" }], false),
      html("span", { class: "name" }, `Candidate ${k + 1}`), html("span", { class: "line" }, `${m.code ? `${m.code} · ` : ""}score ${m.score === null ? "–" : m.score.toFixed(1)}`),
      html("span", { class: "line" }, `${m.x.toFixed(1)}, ${m.y.toFixed(1)}`))));
    replace("cards", ...items, ...gallery);
    byId("marks-note").textContent = order.length
      ? `Each window shows the mark with the shape that was fitted to it; yellow crosses are other candidates, blue ones the place where the ${state.solution ? "fit" : "likeliest pattern, which was not believed,"} has the point. What is changed here changes figures, map, plots and tables at once; verdict, warnings and statements follow with the replay.${pictureless() ? ` The page holds no more windows: ${count(pictureless(), "point has", "points have")} none.` : ""}`
      : (gallery.length ? "No pattern was found. These candidates look most like marks; if they are none, the profile does not fit the paint. " : "There is no mark to show. ")
        + `Marks that you see yourself are placed by a table: their pixels in a CSV with the titles x and y, then autoref-stream solve MARKS.csv --gcps LIST -o NAME.json --size ${D.image.width},${D.image.height} (and the --crs of this run), and autoref-stream apply NAME.json IMAGE.`;
    byId("editor").hidden = !order.length;
    byId("editor").parentElement.classList.toggle("whole", !order.length);
    byId("undo").disabled = !edits.length;
    byId("save").disabled = !edits.length;
    byId("changes").textContent = edits.length ? `${count(edits.length, "change", "changes")}${unsaved() ? "" : ", saved"}` : "";
    document.querySelector(".toolbar").hidden = !order.length;
  }

  function editor() {
    if (!order.length) return;
    const i = selected, p = D.points[i], h = held[i], r = state.rows[i], s = stateOf(i), hasMark = !!(h && h.mark);
    const list = html("dl", { class: "facts" });
    const add = (name, value) => list.append(html("dt", {}, name), html("dd", {}, value));
    add("State", STATES[s] + (h && h.verdict && h.used ? `, ${h.verdict}` : ""));
    if (p.why && !hasMark) add("Why", p.why);
    if (h && h.mark) add("Centre", `${h.mark.x.toFixed(2)}, ${h.mark.y.toFixed(2)} px`);
    if (h && h.mark && h.mark.covariance_px2) add("σ of the centre", `${Math.sqrt((h.mark.covariance_px2[0] + h.mark.covariance_px2[2]) / 2).toFixed(3)} px`);
    if (r) add("Residual", `E ${ground(r.e)}, N ${ground(r.n)}`);
    if (r && r.leaveOneOut !== null) add("Left out", ground(r.leaveOneOut));
    if (state.fit) add("RMSE of the fit", `${ground(state.fit.rmse)}, ${count(state.control, "point", "points")}`);
    const button = (text, key, act, enabled, name) => {
      const b = html("button", { type: "button", "aria-label": name || text, "aria-keyshortcuts": key ? key.replace("⇧←", "Shift+ArrowLeft").replace("⇧→", "Shift+ArrowRight")
        .replace("⇧↑", "Shift+ArrowUp").replace("⇧↓", "Shift+ArrowDown") : null, disabled: !enabled, "data-key": key }, text, key ? html("kbd", {}, key) : null);
      b.addEventListener("click", () => { act(); const again = byId("editor").querySelector(`[data-key="${key}"]`); if (again && !again.disabled) again.focus(); });
      return b;
    };
    const more = others(i).length > 0;
    const note = html("input", { type: "text", id: "note", placeholder: "Note for the record", "aria-label": `Note on ${p.name}` });
    note.value = noteOf(p.name);
    note.addEventListener("change", () => setNote(p.name, note.value));
    const picture = chipOf(i, true);
    const hasPicture = chipIndex(i) !== null;
    if (hasPicture) {
      picture.classList.add("placing");
      picture.addEventListener("click", (event) => placeAt(picture, event));
    }
    replace("editor", picture, html("h3", {}, p.name), list,
      html("div", { class: "buttons" }, button("Accept", "A", accept, hasMark || !!offered(i)), button("Reject", "R", reject, hasMark),
        button("Next candidate", "C", pickNext, more), button("Not visible", "V", notVisible, true)),
      html("div", { class: "nudge" }, "Nudge 0.1 px", button("←", "⇧←", () => nudge(-1, 0), hasMark, "Nudge left"), button("→", "⇧→", () => nudge(1, 0), hasMark, "Nudge right"),
        button("↑", "⇧↑", () => nudge(0, -1), hasMark, "Nudge up"), button("↓", "⇧↓", () => nudge(0, 1), hasMark, "Nudge down")),
      html("p", { class: "sub" }, hasPicture ? "Click in the picture to put the mark there." : "The page has no window of this point."), note);
  }

  // ---- edits
  const unsaved = () => edits.length > 0 && saved !== JSON.stringify(edits);
  // A note that is typed before the first edit waits for it.
  const noteOf = (gcp) => { const mine = edits.filter((e) => e.gcp === gcp); return mine.length ? mine[mine.length - 1].note : notes.get(gcp) || ""; };
  function setNote(gcp, text) {
    const mine = edits.filter((e) => e.gcp === gcp);
    notes.set(gcp, text);
    if (!mine.length) return;
    mine[mine.length - 1].note = text;
    head();
    cards();
  }
  function others(i) {
    const used = new Set(held.filter((h, k) => h && h.used && k !== i).map((h) => h.mark.candidate));
    const now = held[i] && held[i].mark && held[i].used ? held[i].mark.candidate : null;
    return Review.choices(D.points[i]).filter((m) => m.candidate !== now && !used.has(m.candidate));
  }
  function say(text) {
    byId("live").textContent = text;
  }
  function edit(change) {
    const name = D.points[selected].name;
    edits = [...edits, { gcp: name, ...change, note: noteOf(name) }];
    held = Review.applied(D.points, held, edits[edits.length - 1], D.hand_variance_px2);
    changed();
    const s = stateOf(selected), r = state.rows[selected];
    say(`${name}: ${change.action}, ${STATES[s]}${r ? `, residual ${ground(r.length)}` : ""}. ${state.solution ? `RMSE ${ground(state.fit.rmse)} from ${state.control} points.` : "No transform."}`);
  }
  const accept = () => {
    const offer = offered(selected);
    if (offer) edit({ action: "pick", candidate: offer.candidate });
    else if (held[selected] && held[selected].mark) edit({ action: "accept" });
  };
  const reject = () => { if (held[selected] && held[selected].mark) edit({ action: "reject" }); };
  const notVisible = () => edit({ action: "not-visible" });
  function pickNext() {
    const list = others(selected), all = Review.choices(D.points[selected]);
    if (!list.length) return;
    const now = held[selected] && held[selected].mark ? all.findIndex((m) => m.candidate === held[selected].mark.candidate) : -1;
    const next = list.find((m) => all.indexOf(m) > now) || list[0];
    edit({ action: "pick", candidate: next.candidate });
  }
  // A click on the large picture puts the mark there; its user units are pixels of the image.
  function placeAt(picture, event) {
    const matrix = picture.getScreenCTM && picture.getScreenCTM();
    if (!matrix) return;
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
    if (at.x < 0 || at.y < 0 || at.x > D.image.width || at.y > D.image.height) {
      say("That is outside the image.");
      return;
    }
    edit({ action: "move", x: Math.round(at.x * 100) / 100, y: Math.round(at.y * 100) / 100 });
  }
  function nudge(dx, dy) {
    const h = held[selected];
    if (!h || !h.mark) return;
    const x = h.mark.x + 0.1 * dx, y = h.mark.y + 0.1 * dy;
    if (x < 0 || y < 0 || x > D.image.width || y > D.image.height) {
      say("The mark is at the edge of the image.");
      return;
    }
    edit({ action: "move", x, y });
  }
  function undo() {
    if (!edits.length) return;
    const last = edits[edits.length - 1];
    edits = edits.slice(0, -1);
    held = Review.replayed(D.points, edits, D.hand_variance_px2);
    selected = D.points.findIndex((p) => p.name === last.gcp);
    changed();
    say(`Undone: ${last.action} of ${last.gcp}.`);
  }
  function save() {
    if (!edits.length) return;
    const text = JSON.stringify(Review.patch(D.source, edits, state), null, 2) + "\n";
    const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    const link = html("a", { href: url, download: Review.beside(D.source, ".patch.json") });
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
    saved = JSON.stringify(edits);
    head();
    cards();
    focusCard();
    say("Patch saved. Replay it with autoref-stream solve, and write the georeference with autoref-stream apply: the end of the page has both commands.");
  }

  // ---- drawing and keys
  function focusCard() {
    const card = byId("cards").querySelector(`[data-point="${selected}"]`);
    if (card) card.focus({ preventScroll: false });
  }
  function select(i, focus) {
    selected = i;
    for (const card of byId("cards").querySelectorAll("button.card")) {
      const mine = Number(card.dataset.point) === i;
      card.tabIndex = mine ? 0 : -1;
      card.setAttribute("aria-current", mine ? "true" : "false");
    }
    editor();
    if (focus) focusCard();
  }
  function changed() {
    const inCards = byId("cards").contains(document.activeElement);
    state = Review.evaluate(D.points, held, MODEL, MIRRORED);
    head();
    overview();
    plots();
    expected();
    table();
    cards();
    editor();
    if (inCards) focusCard();
  }
  function move(step) {
    const at = order.indexOf(selected) + step;
    if (at >= 0 && at < order.length) select(order[at], true);
  }
  const columnsOfCards = () => getComputedStyle(byId("cards")).gridTemplateColumns.split(" ").length;
  byId("marks").addEventListener("keydown", (event) => {
    const tag = event.target.tagName;
    if (tag === "INPUT" || tag === "SELECT" || event.altKey || event.metaKey || !order.length) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const keys = { a: accept, r: reject, v: notVisible, c: pickNext, u: undo, s: save };
    const key = event.key.toLowerCase();
    if (event.ctrlKey) {
      if (key === "z") undo(); else if (key === "s") save(); else return;
    } else if (arrows && event.shiftKey) nudge(...arrows);
    else if (arrows) move(arrows[0] + arrows[1] * columnsOfCards());
    else if (event.key === "Home") select(order[0], true);
    else if (event.key === "End") select(order[order.length - 1], true);
    else if (keys[key]) keys[key]();
    else return;
    event.preventDefault();
  });
  byId("undo").addEventListener("click", undo);
  byId("save").addEventListener("click", save);
  byId("order").addEventListener("change", cards);
  window.addEventListener("beforeunload", (event) => { if (unsaved()) event.preventDefault(); });

  // ---- the rest
  function sections() {
    const number = (c) => /^([-−+]?\d|–)/.test(c), kind = (c, k) => (k > 0 && number(c) ? null : "text");
    replace("sections", ...D.sections.map((s) => html("section", { "aria-label": s.heading }, html("h2", {}, s.heading), ofRun(), ...s.paragraphs.map((p) => html("p", {}, p)),
      s.reservations.length ? html("ul", { class: "warnings", "aria-label": "Reservations" }, ...s.reservations.map((p) => html("li", {}, p))) : null,
      s.figures.length ? html("dl", { class: "facts" }, ...s.figures.flatMap(([k, v]) => [html("dt", {}, k), html("dd", {}, v)])) : null,
      s.height_arrows.length ? html("div", { class: "plots" }, Draw.heights(s.height_arrows)) : null,
      ...s.tables.map((t) => html("div", { class: "scroll" }, html("table", {}, t.caption ? html("caption", {}, t.caption) : null,
        html("thead", {}, html("tr", {}, ...t.header.map((c, k) => html("th", { scope: "col", class: kind(t.rows.length ? t.rows[0][k] : c, k) }, c)))),
        html("tbody", {}, ...t.rows.map((r) => html("tr", {}, ...r.map((c, k) => html("td", { class: kind(c, k) }, c)))))))))));
  }
  function details() {
    const d = D.details, mib = (b) => `${(b / 1048576).toFixed(0)} MiB`, seconds = (v) => `${v.toFixed(2)} s`;
    const list = (rows) => html("dl", { class: "facts" }, ...rows.filter((r) => r && r[1] !== null && r[1] !== undefined && r[1] !== "").flatMap(([k, v]) => [html("dt", {}, k), html("dd", {}, v)]));
    const t = d.timings, o = d.options || {}, plan = d.memory_plan, reading = d.reading;
    const what = list([["Program", D.program], ["Image", D.image.path], ["Points", D.gcp_file], ["CRS", D.crs], ["Profile", o.profile], ["Reader", d.reader],
      ["Candidates", String(d.candidates_found)],
      ["Hypotheses tried", d.search ? `${grouped(d.search.hypotheses_tried)} of ${grouped(Number(Number(d.search.hypotheses_possible).toPrecision(3)))} possible` : null],
      ["Runner-up", d.runner_up ? `${count(d.runner_up[0], "point", "points")}, false alarms ${chance(d.runner_up[1])}` : "none"],
      ["Earlier georeference", d.moved_m !== null && d.moved_m !== undefined ? `${typeof d.corner_moved_m === "number" ? `its corners move by up to ${ground(d.corner_moved_m)}, ` : ""}its centre moves by ${ground(d.moved_m)}` : null],
      ["Written", d.files_written.join(", ")]]);
    const how = list([["Time", `${seconds(d.elapsed_s)}: open ${seconds(t.open_s)}, scan ${seconds(t.scan_s)}, straddling marks ${seconds(t.examine_s)}, match ${seconds(t.match_s)}, refinement ${seconds(t.rematch_s)}, report ${seconds(t.report_s)}`],
      ["Memory", d.peak_memory_bytes ? `${mib(d.peak_memory_bytes)} at most${plan ? `, ${mib(plan.memory_budget_bytes)} allowed` : ""}` : null],
      ["Tiles", plan ? `${plan.tiles} of ${plan.tile_width_px} × ${plan.tile_height_px} px, ${count(plan.workers, "worker", "workers")}` : null],
      ["Blocks", reading ? `${reading.blocks_decoded} of ${reading.blocks_in_file} decoded once, ${reading.blocks_skipped} empty, ${reading.window_blocks_decoded} again for windows` : null],
      ["Read", reading ? mib(reading.bytes_read + reading.window_bytes_read) : null],
      ["Geotransform", d.geotransform ? d.geotransform.join(", ") : null],
      [MODEL ? `Matrix, ${MODEL}` : "", D.chosen_model && D.chosen_model.matrix ? D.chosen_model.matrix.map((row) => row.join(", ")).join("; ") : null]]);
    const raw = html("details", { class: "noprint" }, html("summary", {}, "All options"), html("pre", {}, JSON.stringify(d.options, null, 1)));
    replace("details", html("div", { class: "columns" }, what, how), raw);
    // Without a mark on the page there is nothing to change.
    const review = D.points.some((p, i) => shownAsCard(i)) ? Review.commands(D.source, o.write, D.image.apart) : "";
    byId("foot").textContent = `${D.program}. This page is complete in itself and loads nothing.${review}`;
  }

  // Drawings again in the width that they have now.
  const redraw = () => { overview(); expected(); };
  let drawn = 0;
  new ResizeObserver(() => {
    const [width] = shownSize();
    if (width !== drawn) redraw();
    drawn = width;
  }).observe(byId("overview"));
  for (const [when, paper] of [["beforeprint", true], ["afterprint", false]]) window.addEventListener(when, () => { onPaper = paper; redraw(); });
  warnings();
  sections();
  details();
  changed();
})();
