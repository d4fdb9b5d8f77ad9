// What the overview and the map of the expected error share: the picture, what lies beside it, and places for names.
const Sketch = (() => {
  const { svg, nice, rounded } = Draw;
  const FOOT = 36;
  // The picture `image` in an element that is `shown` wide and at most so high, in pixels of the screen. Units of the
  // drawing are pixels of the picture; `u` of them are about one on the screen. Around it is room for what lies
  // `outside`, below it for bars of length.
  function frame(image, shown, outside, bars) {
    const W = image.width, H = image.height, [width, height] = shown, most = height - (bars ? FOOT : 0);
    const room = (pad) => Math.max((W + 2 * pad) / width, (H + 2 * pad) / most);
    const pad = outside ? 26 * room(0) : 0, u = room(pad), foot = bars ? FOOT * u : 0;
    const box = svg("svg", { viewBox: `${-pad} ${-pad} ${W + 2 * pad} ${H + 2 * pad + foot}`, role: "img" });
    box.append(svg("image", { href: image.src, width: W, height: H, style: "filter:saturate(.55) brightness(1.12) contrast(.9)" }));
    return { box, u, W, H, pad, below: H + pad };
  }
  // A vector on the map, metres, as one in the drawing with `f` units a pixel of the image.
  function onImage(s, e, n, f) {
    const q = s.a_re * s.a_re + s.a_im * s.a_im;
    return [(s.mirrored ? -1 : 1) * (s.a_re * e + s.a_im * n) / q * f, -(s.a_re * n - s.a_im * e) / q * f];
  }
  const text = (words, u, attributes) => svg("text", { class: "halo", "font-size": 12 * u, style: `stroke-width:${3 * u}px`, ...attributes }, words);
  // Bars of length under the picture, where no point can lie on them: [length in the drawing, words] each.
  function bars(drawing, lengths) {
    const { box, u, pad, below } = drawing;
    let x = 4 * u - pad;
    const y = below + 30 * u;
    for (const [width, words] of lengths) {
      box.append(svg("path", { class: "bar", d: `M${x} ${y - 4 * u} V${y} H${x + width} V${y - 4 * u}`, fill: "none", stroke: "#1b2530", "stroke-width": 1.6 * u }),
        text(words, u, { x, y: y - 8 * u }));
      x += Math.max(width, 7.2 * words.length * u) + 32 * u;
    }
  }
  // A bar of a round length on the ground; `scale` is metres a unit of the drawing.
  function ruler(u, scale) {
    const length = nice(160 * u * scale);
    return [length / scale, rounded(length)];
  }
  // The arrow to north, in an upper corner without symbols if there is one; gives the place that it takes.
  function north(drawing, s, symbols) {
    const { box, u, W } = drawing, around = (cx) => [cx - 30 * u, 4 * u, 60 * u, 64 * u];
    const isClear = ([l, t, w, h]) => symbols.every(([x, y]) => x < l || x > l + w || y < t || y > t + h);
    const cx = [W - 30 * u, 30 * u].find((c) => isClear(around(c))) || W - 30 * u, cy = 36 * u, r = 20 * u;
    const [x, y] = onImage(s, 0, 1, 1), l = Math.hypot(x, y), nx = x / l, ny = y / l;
    const tip = [cx + nx * r, cy + ny * r], side = [-ny * 6 * u, nx * 6 * u], foot = [cx - nx * r * 0.6, cy - ny * r * 0.6];
    box.append(svg("path", { d: `M${tip} L${foot[0] + side[0]} ${foot[1] + side[1]} L${cx - nx * r * 0.25} ${cy - ny * r * 0.25} L${foot[0] - side[0]} ${foot[1] - side[1]} Z`,
      fill: "#1b2530", stroke: "#fff", "stroke-width": 1.6 * u }),
    text("N", u, { x: tip[0] + nx * 9 * u, y: tip[1] + ny * 9 * u + 4 * u, "text-anchor": "middle" }));
    return around(cx);
  }
  // Finds each name a place beside its symbol where no other name or symbol stands; null when there is none: the table has all.
  function labelPlaces(drawing, symbols, also) {
    const { u, W, H, pad } = drawing;
    const taken = [...also, ...symbols.map(([x, y]) => [x - 7 * u, y - 7 * u, 14 * u, 14 * u])];
    return (x, y, name) => {
      // Letters of the widest of the fonts.
      const w = 8.2 * name.length * u, h = 13 * u;
      for (const [dx, dy, anchor] of [[10, -7, "start"], [-10, -7, "end"], [10, 16, "start"], [-10, 16, "end"], [0, -12, "middle"], [0, 22, "middle"]]) {
        const left = x + dx * u - (anchor === "end" ? w : anchor === "middle" ? w / 2 : 0), top = y + dy * u - 0.8 * h;
        const fits = left >= -pad && left + w <= W + pad && top >= -pad && top + h <= H + pad;
        if (fits && taken.every(([l, t, tw, th]) => left + w <= l || left >= l + tw || top + h <= t || top >= t + th)) {
          taken.push([left, top, w, h]);
          return { x: x + dx * u, y: y + dy * u, anchor };
        }
      }
      return null;
    };
  }
  return { frame, onImage, bars, ruler, north, labelPlaces };
})();
