"use strict";
const Sheet = (() => {
  const frames = [], edits = [], rank = { failed: 0, doubtful: 1, ok: 2 };
  const titles = { failed: "Failed", doubtful: "Doubtful", ok: "OK" };
  let roll, saved = 0, current = null, order = [];
  const $ = id => document.getElementById(id);
  const el = (tag, name, text) => { const e = document.createElement(tag); if (name) e.className = name; if (text !== undefined) e.textContent = text; return e; };

  // The mark as the edits leave it.
  function held(f, m) {
    let s = { x: m.x, y: m.y, used: m.status === "ok", word: m.status, by: "" };
    for (const e of edits) {
      if (e.frame !== f.name || e.mark !== m.mark) continue;
      if (e.action === "move") s = { x: e.x, y: e.y, used: true, word: "placed", by: "hand" };
      else if (e.action === "accept") s = { ...s, used: true, word: "accepted", by: "hand" };
      else if (e.action === "reject") s = { ...s, used: false, word: "rejected", by: "hand" };
      else s = { x: null, y: null, used: false, word: "not visible", by: "hand" };
    }
    return s;
  }

  // What a replay gives for a frame: {n, model, rmse_um, residual_um: {mark: [x, y]}}.
  function evaluate(f) {
    const all = f.marks.map(m => ({ mark: m.mark, ...held(f, m), X: roll.marks[m.mark][0], Y: roll.marks[m.mark][1] }));
    const used = all.filter(m => m.used && m.x !== null), fit = Fit.fit(used, roll.model, f.flip), residual_um = {};
    if (fit) for (const m of all) if (m.x !== null) {
      const [A, B] = fit.apply(m.x, m.y);
      residual_um[m.mark] = [1e3 * (A - m.X), 1e3 * (B - m.Y)];
    }
    return { n: used.length, model: fit && fit.model, rmse_um: fit ? fit.rmse_um : null, residual_um };
  }

  function show(f) {
    const r = evaluate(f), touched = edits.some(e => e.frame === f.name);
    f.small.textContent = (r.rmse_um === null ? "  no orientation" : "  " + r.n + " of " + f.marks.length + " marks, " + r.model + ", RMSE " + r.rmse_um.toFixed(1) + " µm") + (touched ? " · reviewed; the replay judges it" : "");
    for (const m of f.marks) {
      const s = held(f, m), d = r.residual_um[m.mark];
      m.t.replaceChildren(el("b", "", m.mark), el("span", s.used ? "used" : "left", " " + s.word),
        document.createTextNode((s.x === null ? "" : " · " + s.x.toFixed(2) + ", " + s.y.toFixed(2)) + (d ? " · " + Math.hypot(d[0], d[1]).toFixed(1) + " µm" : "")));
      m.e.setAttribute("aria-label", f.name + " " + m.t.textContent + (m.reason ? ", " + m.reason : ""));
      for (const c of m.e.querySelectorAll(".c")) cross(c, m, s);
    }
    if (current && current.f === f) zoom();
  }

  // Lines through the mark's centre; a chip shows `side` values of `step` pixels.
  function cross(c, m, s) {
    const [h, v] = c.querySelectorAll("i"), unit = 100 / (roll.side * m.step);
    h.hidden = v.hidden = s.x === null || m.col === null;
    if (s.x === null) return;
    h.style.top = "calc(" + (s.y - m.top) * unit + "% - .5px)";
    v.style.left = "calc(" + (s.x - m.left) * unit + "% - .5px)";
  }

  function chip(f, m, row) {
    const c = el("span", m.col === null ? "c none" : "c");
    if (m.col !== null) {
      const n = f.columns;
      c.style.backgroundSize = n * 100 + "% 200%";
      c.style.backgroundPosition = (n > 1 ? m.col * 100 / (n - 1) : 0) + "% " + row * 100 + "%";
    }
    c.append(el("i", "h"), el("i", "v"));
    return c;
  }

  const picture = f => f.columns ? "url(\"" + roll.folder + "/" + encodeURIComponent(f.name) + ".jpg\")" : "none";
  // Pictures are asked for when a frame comes near the window and given back when it is gone.
  const seen = new IntersectionObserver(list => {
    for (const e of list) for (const c of e.target.querySelectorAll(".c:not(.none)")) c.style.backgroundImage = e.isIntersecting ? picture(e.target.frame) : "";
  }, { rootMargin: "600px" });

  function build(f) {
    const s = el("section"), head = el("h3", "", f.name), row = el("div", "row");
    s.frame = f; f.e = s;
    f.small = el("small"); head.append(f.small);
    s.append(head);
    if (f.reasons.length) s.append(el("p", "why", f.reasons.join("; ")));
    for (const m of f.marks) {
      m.e = el("div", "m"); m.e.tabIndex = 0; m.e.setAttribute("role", "group");
      const chips = el("div", "chips"); chips.append(chip(f, m, 0), chip(f, m, 1));
      m.t = el("div", "t");
      m.e.append(chips, m.t);
      if (m.reason) m.e.append(el("div", "why", m.reason));
      m.e.addEventListener("focus", () => { current = { f, m }; zoom(); });
      m.e.addEventListener("keydown", k => key(k, f, m));
      row.append(m.e);
    }
    s.append(row);
    return s;
  }

  function zoom() {
    const z = $("zoom"), { f, m } = current;
    z.hidden = m.col === null;
    z.querySelector("p").textContent = f.name + " " + m.t.textContent;
    z.querySelectorAll(".c").forEach((c, row) => {
      const made = chip(f, m, row);
      c.style.cssText = made.style.cssText; c.style.backgroundImage = picture(f);
      cross(c, m, held(f, m));
    });
  }

  // Groups are those of the run: a frame that was changed is judged when the patch is replayed.
  function counts() {
    const parts = [];
    for (const group of document.querySelectorAll(".group")) {
      const list = frames.filter(f => f.status === group.dataset.status), changed = list.filter(f => edits.some(e => e.frame === f.name)).length;
      const by = changed ? ", " + changed + " of them changed here" : "";
      group.querySelector("h2").textContent = titles[group.dataset.status] + " (" + list.length + by + ")";
      parts.push(list.length + " " + titles[group.dataset.status]);
    }
    $("counts").textContent = frames.length + " frame" + (frames.length === 1 ? "" : "s") + ": " + parts.join(", ") + ", worst first"
      + (edits.length ? "; as the run found them, changes are judged by the replay. " : ". ");
  }

  function say(text) {
    $("say").textContent = text;
    counts();
    const looked = new Set(edits.map(e => e.frame)).size;
    $("save").textContent = "Save patch (" + edits.length + " edit" + (edits.length === 1 ? "" : "s") + ", " + looked + " frame" + (looked === 1 ? "" : "s") + ")";
  }

  // What the sheet showed of a mark, so that a patch is not replayed on another roll.
  const was = m => m.x === null ? {} : { was: [m.x, m.y] };

  function move(f, m, x, y) {
    const last = edits[edits.length - 1];
    // Nudges in a row are one step.
    if (last && last.action === "move" && last.frame === f.name && last.mark === m.mark) { last.x = x; last.y = y; }
    else edits.push({ frame: f.name, mark: m.mark, action: "move", x, y, ...was(m), note: "" });
    changed(f, m);
  }

  function changed(f, m) { show(f); say(f.name + " " + m.t.textContent); }

  function go(f, m, marks, lines) {
    const shown = order.filter(g => !g.e.parentElement.classList.contains("hide") && g.marks.length);
    let i = shown.indexOf(f), k = f.marks.indexOf(m) + marks;
    if (marks && k < 0 && i > 0) { i--; k = shown[i].marks.length - 1; }
    else if (marks && k >= f.marks.length && i + 1 < shown.length) { i++; k = 0; }
    i = Math.max(0, Math.min(shown.length - 1, i + lines));
    const next = shown[i].marks[Math.max(0, Math.min(shown[i].marks.length - 1, k))].e;
    next.focus({ preventScroll: true });
    next.scrollIntoView({ block: lines || marks ? "center" : "nearest" });
  }

  function key(k, f, m) {
    const name = k.key.length === 1 ? k.key.toLowerCase() : k.key, command = k.ctrlKey || k.metaKey;
    if (k.altKey || (command && name !== "z" && name !== "s")) return;
    const s = held(f, m), put = action => { edits.push({ frame: f.name, mark: m.mark, action, ...was(m), note: "" }); changed(f, m); };
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[name];
    if (arrow && k.shiftKey) {
      const half = roll.side * m.step / 2, from = s.x === null ? { x: m.left + half, y: m.top + half } : s;
      if (m.col !== null) move(f, m, from.x + 0.1 * arrow[0], from.y + 0.1 * arrow[1]);
    }
    else if (arrow) go(f, m, arrow[0], arrow[1]);
    else if (name === "a") { if (s.x === null) say(f.name + " " + m.mark + ": no place to accept; move it first"); else put("accept"); }
    else if (name === "r") put("reject");
    else if (name === "v") put("not-visible");
    else if (name === "u" || (command && name === "z")) undo();
    else if (name === "s") save();
    else return;
    k.preventDefault();
  }

  function undo() {
    const e = edits.pop();
    if (!e) return;
    const f = frames.find(g => g.name === e.frame);
    show(f); say("undone: " + e.frame + " " + e.mark + " " + e.action);
  }

  const patch = () => ({ schema: "autoref-stream-patch", schema_version: 1, for: "fiducials", source: roll.source, edits });

  function save() {
    const a = el("a");
    a.href = "data:application/json;charset=utf-8," + encodeURIComponent(JSON.stringify(patch(), null, 1) + "\n");
    a.download = "fiducials.patch.json";
    a.click();
    saved = JSON.stringify(edits);
    say("saved fiducials.patch.json; replay it: the same fiducials command with --patch fiducials.patch.json");
  }

  function start() {
    frames.sort((a, b) => rank[a.status] - rank[b.status] || b.worst - a.worst || (a.name < b.name ? -1 : 1));
    order = frames;
    const main = document.querySelector("main");
    for (const status of Object.keys(rank)) {
      const list = frames.filter(f => f.status === status);
      if (!list.length) continue;
      const group = el("div", "group"); group.dataset.status = status;
      group.append(el("h2", status));
      for (const f of list) { group.append(build(f)); }
      main.append(group);
      for (const f of list) { show(f); seen.observe(f.e); }
    }
    $("save").addEventListener("click", save);
    $("show").addEventListener("change", () => {
      for (const g of document.querySelectorAll(".group")) g.classList.toggle("hide", $("show").value === "look" && g.dataset.status === "ok");
    });
    document.querySelectorAll("#zoom .c").forEach(c => c.addEventListener("click", k => {
      const { f, m } = current, box = c.getBoundingClientRect(), side = roll.side * m.step;
      move(f, m, m.left + (k.clientX - box.left) / box.width * side, m.top + (k.clientY - box.top) / box.height * side);
      m.e.focus({ preventScroll: true });
    }));
    addEventListener("beforeunload", e => { if (edits.length && JSON.stringify(edits) !== saved) e.preventDefault(); });
    say("");
  }

  return { roll: r => { roll = r; }, frame: f => frames.push(f), start, frames, edits, evaluate, held, patch };
})();
