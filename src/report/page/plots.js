// Drawing: small helpers for SVG and the plots. Text reaches the document as text only.
const Draw = (() => {
  const SVG = "http://www.w3.org/2000/svg";
  function fill(element, attributes, children) {
    for (const [name, value] of Object.entries(attributes || {})) {
      if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
    }
    for (const child of children) {
      if (child !== null && child !== undefined) element.append(child);
    }
    return element;
  }
  const svg = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);
  const html = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);

  const metres = (v) => (v === null || v === undefined ? "–" : (Math.abs(v) >= 100 ? v.toFixed(1) : (Math.abs(v) < 0.0005 ? 0 : v).toFixed(3)));
  // So many decimals, without a sign before zero.
  const fixed = (v, n) => v.toFixed(n).replace(/^-(0\.?0*)$/, "$1");
  const superscript = (n) => String(n).replace(/[-0-9]/g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)]));
  // A count in groups of three digits; what is too large to be read so in powers of ten.
  const grouped = (v) => (v < 1e9 ? Math.round(v).toLocaleString("en") : v.toExponential(1).replace(/e\+?(-?\d+)$/, (_, n) => ` × 10${superscript(n)}`));
  // A length on the ground with its unit: millimetres below a metre.
  function ground(v) {
    if (v === null || v === undefined) return "–";
    return Math.abs(v) < 1 ? `${fixed(1000 * v, Math.abs(v) < 0.1 ? 1 : 0)} mm` : `${metres(v)} m`;
  }
  const pixels = (v) => (v === null || v === undefined ? "–" : v.toFixed(2));

  // The largest of 1, 2, 5 times a power of ten that is not above v.
  function nice(v) {
    const power = Math.pow(10, Math.floor(Math.log10(v))), f = v / power;
    return (f >= 5 ? 5 : f >= 2 ? 2 : 1) * power;
  }
  // A round length with its unit.
  const rounded = (v) => (v < 1 ? `${Number((1000 * v).toPrecision(6))} mm` : `${Number(v.toPrecision(6))} m`);
  const brief = (name) => (name.length > 18 ? `${name.slice(0, 17)}…` : name);
  const label = (v) => String(Number(v.toPrecision(6)));

  // Symbols of radius r about the origin.
  const symbols = {
    found: (r) => svg("circle", { r, fill: "none", stroke: "#17713f", "stroke-width": r * 0.36 }),
    check: (r) => svg("path", { d: `M0 ${-r * 1.2} L${r * 1.1} ${r * 0.8} L${-r * 1.1} ${r * 0.8} Z`, fill: "none", stroke: "#6a3fa0", "stroke-width": r * 0.36 }),
    "not-found": (r) => svg("path", { d: `M${-r} ${-r} L${r} ${r} M${-r} ${r} L${r} ${-r}`, stroke: "#ae2a1f", "stroke-width": r * 0.4 }),
    outside: (r) => svg("path", { d: `M0 ${-r} L${r} 0 L0 ${r} L${-r} 0 Z`, fill: "#fff", stroke: "#5c6875", "stroke-width": r * 0.3 }),
    proposed: (r) => svg("circle", { r, fill: "none", stroke: "#c07a00", "stroke-width": r * 0.36, "stroke-dasharray": `${r * 0.9} ${r * 0.5}` }),
  };
  // The same on a white border, for pictures.
  function symbol(kind, r, x, y) {
    const below = symbols[kind](r);
    below.setAttribute("stroke", "#fff");
    below.setAttribute("stroke-width", Number(below.getAttribute("stroke-width")) * 2.3);
    below.removeAttribute("stroke-dasharray");
    return svg("g", { transform: `translate(${x} ${y})` }, below, symbols[kind](r));
  }
  function legendItem(kind, text) {
    return html("span", {}, svg("svg", { viewBox: "-9 -9 18 18", "aria-hidden": "true" }, symbols[kind](5)), text);
  }

  // An axis in metres that stays below one metre is labelled in millimetres.
  function inUnit(range, name) {
    const small = /, m$/.test(name) && Math.max(...range.map(Math.abs)) < 1;
    return small ? { name: name.replace(/m$/, "mm"), text: (v) => label(1000 * v) } : { name, text: label };
  }

  // Axes of a plot of 520 × 290 with nice ticks, upright ones at least `least` apart; returns the place of a value.
  function axes(box, xr, yr, xName, yName, least) {
    const across = inUnit(xr, xName), up = inUnit(yr, yName);
    const W = 520, H = 290, left = 62, right = 12, top = 10, bottom = 42;
    const x = (v) => left + (v - xr[0]) / (xr[1] - xr[0]) * (W - left - right);
    const y = (v) => H - bottom - (v - yr[0]) / (yr[1] - yr[0]) * (H - top - bottom);
    const ticks = (r, n, smallest) => {
      const step = Math.max(nice((r[1] - r[0]) / n * 1.8), smallest || 0), out = [];
      for (let k = Math.ceil(r[0] / step - 1e-9); k * step <= r[1] + step * 1e-9; k++) out.push(k * step);
      return out;
    };
    for (const v of ticks(yr, 7, least)) {
      box.append(svg("line", { class: "grid", x1: left, x2: W - right, y1: y(v), y2: y(v) }),
        svg("text", { class: "tick", x: left - 7, y: y(v) + 4, "text-anchor": "end" }, up.text(v)));
    }
    for (const v of ticks(xr, 9)) {
      box.append(svg("line", { class: "axis", x1: x(v), x2: x(v), y1: H - bottom, y2: H - bottom + 4 }),
        svg("text", { class: "tick", x: x(v), y: H - bottom + 17, "text-anchor": "middle" }, across.text(v)));
    }
    box.append(svg("path", { class: "axis", d: `M${left} ${top} V${H - bottom} H${W - right}` }),
      svg("text", { class: "tick", x: (left + W - right) / 2, y: H - 6, "text-anchor": "middle" }, across.name),
      svg("text", { class: "tick", x: 0, y: 0, transform: `translate(13 ${(top + H - bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, up.name));
    return { x, y, left, right: W - right, top, bottom: H - bottom };
  }

  function figure(id, title, describe, caption, draw) {
    const box = svg("svg", { viewBox: "0 0 520 290", role: "img", "aria-label": `${title}. ${describe}` });
    draw(box);
    return html("figure", { id, "aria-label": title }, html("h3", {}, title), box, html("figcaption", {}, caption));
  }

  const BLUE = "#0a5a9c", ORANGE = "#c2610c";
  const dot = (x, y, colour, check, name) => (check
    ? svg("path", { d: `M${x} ${y - 5} l4.6 8.2 h-9.2 Z`, fill: "none", stroke: "#6a3fa0", "stroke-width": 1.6 }, svg("title", {}, name))
    : svg("circle", { cx: x, cy: y, r: 3.4, fill: colour, "fill-opacity": 0.75 }, svg("title", {}, name)));

  // A name to the right or left of a place, on the other side where it would leave the plot.
  function beside(a, x, y, name, right) {
    const text = brief(name), w = 7 + 6.2 * text.length;
    const after = right ? x + w < a.right + 10 || x - w < a.left : x - w < a.left;
    return svg("text", { class: "tick halo", x: x + (after ? 7 : -7), y, "text-anchor": after ? "start" : "end" }, text);
  }

  // items: {name, e, n, length, distance (m from the middle of the image), check}
  function vectors(items, sigma0) {
    const reach = Math.max(...items.map((i) => i.length), sigma0 ? 2.5 * sigma0 : 0, 1e-4) * 1.12;
    return figure("plot-vectors", "Vectors from one origin", `${items.length} residuals, easting and northing.`,
      sigma0 ? "Surveyed − computed. Circles hold 39 % and 95 % of the residuals of a normal fit."
        : "Surveyed − computed.", (box) => {
        const wide = reach * (520 - 68) / (290 - 52);
        const a = axes(box, [-wide, wide], [-reach, reach], "easting, m", "northing, m");
        box.append(svg("path", { class: "axis", d: `M${a.x(0)} ${a.top} V${a.bottom} M${a.left} ${a.y(0)} H${a.right}`, "stroke-dasharray": "2 3" }));
        if (sigma0) {
          for (const k of [1, 2.4477]) {
            box.append(svg("circle", { cx: a.x(0), cy: a.y(0), r: Math.abs(a.x(k * sigma0) - a.x(0)), fill: "none", stroke: "#9aa5b0", "stroke-width": 1 }));
          }
        }
        for (const i of items) {
          box.append(svg("line", { x1: a.x(0), y1: a.y(0), x2: a.x(i.e), y2: a.y(i.n), stroke: i.check ? "#6a3fa0" : BLUE, "stroke-width": 1, "stroke-opacity": 0.6 }),
            dot(a.x(i.e), a.y(i.n), BLUE, i.check, i.name));
        }
        for (const i of [...items].sort((p, q) => q.length - p.length).slice(0, 4)) {
          box.append(beside(a, a.x(i.e), a.y(i.n) - 5, i.name, i.e >= 0));
        }
      });
  }

  function histogram(items, sigma0) {
    const fitted = items.filter((i) => !i.check), all = fitted.flatMap((i) => [i.e, i.n]);
    const most = Math.max(...all.map(Math.abs), 1e-4), width = nice(most * 2 / Math.max(5, Math.min(14, Math.sqrt(all.length) * 1.6)));
    const half = Math.ceil(most / width + 0.5) * width - width / 2, bins = Math.round(2 * half / width);
    const count = (key) => {
      const out = new Array(bins).fill(0);
      for (const i of fitted) out[Math.min(bins - 1, Math.max(0, Math.floor((i[key] + half) / width)))]++;
      return out;
    };
    const e = count("e"), n = count("n"), top = Math.max(...e, ...n);
    return figure("plot-histogram", "Histogram", `${fitted.length} residuals in each of easting and northing.`,
      caption([[BLUE, "easting"], [ORANGE, "northing"]], sigma0 ? "; the curve is the normal distribution of the fit." : "."), (box) => {
        const curve = (v) => fitted.length * width / (sigma0 * Math.sqrt(2 * Math.PI)) * Math.exp(-v * v / (2 * sigma0 * sigma0));
        const high = Math.max(top, sigma0 ? Math.min(curve(0), top * 1.6) : 0) * 1.1;
        const a = axes(box, [-half, half], [0, high], "residual, m", "points", 1);
        const w = (a.x(width) - a.x(0)) / 2 - 1.5;
        for (let k = 0; k < bins; k++) {
          const x0 = a.x(-half + k * width);
          if (e[k]) box.append(svg("rect", { x: x0 + 1, width: w, y: a.y(e[k]), height: a.bottom - a.y(e[k]), fill: BLUE }));
          if (n[k]) box.append(svg("rect", { x: x0 + w + 2, width: w, y: a.y(n[k]), height: a.bottom - a.y(n[k]), fill: ORANGE }));
        }
        if (sigma0) {
          const path = [];
          for (let k = 0; k <= 80; k++) {
            const v = -half + 2 * half * k / 80;
            path.push(`${a.x(v).toFixed(1)} ${Math.max(a.top, a.y(curve(v))).toFixed(1)}`);
          }
          box.append(svg("path", { d: "M" + path.join("L"), fill: "none", stroke: "#5c6875", "stroke-width": 1.4 }));
        }
      });
  }
  function caption(colours, rest) {
    const out = html("span", {});
    colours.forEach(([colour, name], i) => {
      out.append(i ? ", " : "", svg("svg", { viewBox: "0 0 10 10", width: 10, height: 10, style: "display:inline;width:10px;height:10px", "aria-hidden": "true" },
        svg("rect", { width: 10, height: 10, fill: colour })), " " + name);
    });
    out.append(rest);
    return out;
  }

  function distance(items) {
    const far = Math.max(...items.map((i) => i.distance), 1) * 1.04, most = Math.max(...items.map((i) => i.length), 1e-4) * 1.12;
    return figure("plot-distance", "Against the distance from the image's centre", `${items.length} residual lengths.`,
      "A rise outwards shows bending that a similarity cannot follow.", (box) => {
        const a = axes(box, [0, far], [0, most], "distance, m", "residual, m");
        for (const i of items) box.append(dot(a.x(i.distance), a.y(i.length), BLUE, i.check, i.name));
        for (const i of [...items].sort((p, q) => q.length - p.length).slice(0, 3)) {
          box.append(beside(a, a.x(i.distance), a.y(i.length) + 4, i.name, false));
        }
      });
  }

  // Inverse of the standard normal distribution: P. J. Acklam's rational approximation (2003), relative error 1.2e-9.
  function quantile(p) {
    const a = [-39.69683028665376, 220.9460984245205, -275.9285104469687, 138.357751867269, -30.66479806614716, 2.506628277459239];
    const b = [-54.47609879822406, 161.5858368580409, -155.6989798598866, 66.80131188771972, -13.28068155288572];
    const c = [-0.007784894002430293, -0.3223964580411365, -2.400758277161838, -2.549732539343734, 4.374664141464968, 2.938163982698783];
    const d = [0.007784695709041462, 0.3224671290700398, 2.445134137142996, 3.754408661907416];
    const poly = (k, x) => k.reduce((s, v) => s * x + v, 0);
    if (p < 0.02425) {
      const q = Math.sqrt(-2 * Math.log(p));
      return poly(c, q) / (poly(d, q) * q + 1);
    }
    if (p > 1 - 0.02425) return -quantile(1 - p);
    const q = p - 0.5, r = q * q;
    return poly(a, r) * q / (poly(b, r) * r + 1);
  }

  function quantiles(items, sigma0) {
    const fitted = items.filter((i) => !i.check && i.redundancy > 1e-9);
    const all = fitted.flatMap((i) => ["e", "n"].map((k) => ({ name: i.name, key: k, v: i[k] * Math.sqrt(i.weight / i.redundancy) / sigma0 })));
    all.sort((p, q) => p.v - q.v);
    const n = all.length, at = (k) => quantile((k + 0.625) / (n + 0.25));
    const reach = Math.max(Math.abs(at(0)), ...all.map((p) => Math.abs(p.v))) * 1.08;
    return figure("plot-quantiles", "Quantiles", `${n} standardised residuals against the normal distribution.`,
      caption([[BLUE, "easting"], [ORANGE, "northing"]], ", each in units of its own standard deviation. Normal residuals lie along the line."), (box) => {
        const a = axes(box, [-reach, reach], [-reach, reach], "expected of a normal distribution", "residual / σ");
        box.append(svg("line", { class: "axis", x1: a.x(-reach), y1: a.y(-reach), x2: a.x(reach), y2: a.y(reach) }));
        all.forEach((p, k) => box.append(dot(a.x(at(k)), a.y(p.v), p.key === "e" ? BLUE : ORANGE, false, p.name)));
      });
  }

  // Points in plan, each with an arrow up or down the page: residual of height, surveyed − corrected model.
  function heights(points) {
    const list = points.map((p) => `${p.name} ${ground(p.residual_m)}`).join(", ");
    return figure("plot-heights", "Residuals of height", `Surveyed minus corrected model: ${list}.`,
      "Arrows up: the survey is above the corrected model. Arrows of one direction side by side show a tilt or a bend that the surface does not follow.", (box) => {
      // Counted from a round place, so that ticks are short; above and below there is room for arrows.
      const base = (key) => Math.floor(Math.min(...points.map((p) => p[key])) / 1000) * 1000;
      const range = (key, share) => {
        const values = points.map((p) => p[key] - base(key)), low = Math.min(...values), high = Math.max(...values), pad = Math.max((high - low) * share, 1);
        return [low - pad, high + pad];
      };
      const from = (key) => (base(key) ? `${key} − ${base(key)}, m` : `${key}, m`);
      const a = axes(box, range("easting", 0.1), range("northing", 0.35), from("easting"), from("northing"));
      const longest = Math.max(...points.map((p) => Math.abs(p.residual_m)), 1e-6);
      const unit = nice(longest), perMetre = 46 / longest, taken = [{ x: a.right - 70, y: a.top + 20, w: 80 }, { x: a.right - 70, y: a.top + 40, w: 80 }];
      for (const p of points) {
        const x = a.x(p.easting - base("easting")), y = a.y(p.northing - base("northing")), tip = y - p.residual_m * perMetre, turn = p.residual_m < 0 ? -1 : 1;
        const colour = p.check ? "#6a3fa0" : "#17713f";
        box.append(svg("circle", { cx: x, cy: y, r: 2.4, fill: colour }),
          svg("path", { d: `M${x} ${y} V${tip}`, stroke: colour, "stroke-width": 1.6, fill: "none" }));
        if (Math.abs(y - tip) > 4) box.append(svg("path", { d: `M${x - 3.4} ${tip + 5 * turn} L${x} ${tip} L${x + 3.4} ${tip + 5 * turn}`, stroke: colour, "stroke-width": 1.6, fill: "none" }));
        // A name where no other stands; the table has them all.
        const at = { x: x + 6, y: y + 4, w: 6.2 * brief(p.name).length };
        if (at.x + at.w < a.right + 10 && taken.every((t) => Math.abs(t.y - at.y) > 11 || at.x > t.x + t.w || t.x > at.x + at.w)) {
          taken.push(at);
          box.append(svg("text", { class: "tick", x: at.x, y: at.y }, brief(p.name)));
        }
      }
      const foot = a.top + 8 + unit * perMetre;
      box.append(svg("path", { d: `M${a.right - 8} ${foot} V${foot - unit * perMetre}`, stroke: "#1b2530", "stroke-width": 1.6 }),
        svg("text", { class: "tick", x: a.right - 13, y: foot - unit * perMetre / 2 + 4, "text-anchor": "end" }, rounded(unit)));
    });
  }

  return { heights, svg, html, metres, ground, pixels, fixed, superscript, grouped, nice, label, rounded, brief, symbol, legendItem, vectors, histogram, distance, quantiles };
})();
