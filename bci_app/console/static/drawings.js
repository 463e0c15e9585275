// Drawings by hand, in SVG: the map, the newest verdicts, the head. Nothing here knows where its values come from.

const SVG = "http://www.w3.org/2000/svg";

/** An SVG element with attributes, a class among them, and children. */
export function mark(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

const titled = (text) => mark("title", {}, document.createTextNode(text));

/** The map with belief, trajectory, agent and goal; (row, column) from the north-west. */
export function drawWorld(svg, layout, episode) {
  if (!layout.length) return;
  const height = layout.length, width = layout[0].length;
  svg.setAttribute("viewBox", `-0.1 -0.1 ${width + 0.2} ${height + 0.2}`);
  const parts = [];
  const largest = episode?.belief ? Math.max(...episode.belief.goal, 1e-9) : 1;
  let cell = 0;
  layout.forEach((row, r) => [...row].forEach((character, c) => {
    const place = { x: c, y: r, width: 1, height: 1 };
    if (character === "#") { parts.push(mark("rect", { ...place, class: "wall" })); return; }
    const probability = episode?.belief?.goal[cell];
    cell += 1;
    if (probability) {
      // The square root: small beliefs stay visible beside a large one.
      const opacity = (0.75 * Math.sqrt(probability / largest)).toFixed(3);
      const square = mark("rect", { ...place, class: "probable", "fill-opacity": opacity });
      square.append(titled(`row ${r}, column ${c}: ${(100 * probability).toFixed(2)} %`));
      parts.push(square);
    }
    parts.push(mark("rect", { ...place, class: "cell" }));
  }));
  if (episode) parts.push(...trajectory(episode));
  svg.replaceChildren(...parts);
}

function trajectory(episode) {
  const middle = ([r, c]) => [c + 0.5, r + 0.5];
  const points = [episode.start, ...episode.path.map((move) => move.position)].map(middle);
  const parts = [mark("polyline", { points: points.map((point) => point.join(",")).join(" "), class: "path" })];
  const [x0, y0] = points[0];
  parts.push(mark("circle", { cx: x0, cy: y0, r: 0.22, class: "start-mark" }));
  if (episode.goal) {
    const [x, y] = middle(episode.goal);
    const diamond = `${x},${y - 0.38} ${x + 0.38},${y} ${x},${y + 0.38} ${x - 0.38},${y}`;
    parts.push(mark("polygon", { points: diamond, class: "goal-mark" }));
  }
  episode.path.forEach((move, index) => {
    if (!move.truth) return;
    const [x, y] = [0, 1].map((axis) => (points[index][axis] + points[index + 1][axis]) / 2);
    parts.push(mark("path", { d: `M${x - 0.12} ${y - 0.12}l.24 .24m0 -.24l-.24 .24`, class: "mistake" }));
  });
  const [x, y] = points.at(-1);
  parts.push(mark("circle", { cx: x, cy: y, r: 0.27, class: "agent-mark" }));
  return parts;
}

const MOST = 6; // of the evidence that is drawn

/** A bar for each verdict: up says error, down correct, hollow is wrong; a dot below where the move was an error. */
export function drawBars(svg, verdicts, most) {
  const width = svg.clientWidth || 600, height = 120, middle = 54, left = 26, pitch = (width - left) / most;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const scale = (evidence) => middle - (48 * Math.max(-MOST, Math.min(MOST, evidence))) / MOST;
  const parts = [mark("line", { x1: left, x2: width, y1: middle, y2: middle, class: "axis" })];
  for (const tick of [-MOST, 0, MOST]) {
    parts.push(mark("text", { x: 2, y: scale(tick) + 4, class: "tick" }, document.createTextNode(String(tick))));
  }
  verdicts.forEach((verdict, index) => {
    const x = left + (most - verdicts.length + index) * pitch;
    const score = verdict.evidence ?? verdict.log_odds;
    const known = score !== null;
    const top = known ? Math.min(middle, scale(score)) : middle - 3;
    const size = known ? Math.max(1.5, Math.abs(scale(score) - middle)) : 6;
    const kind = known ? `${verdict.outcome}${isWrong(verdict) ? " wrong" : ""}` : "none";
    const bar = mark("rect", { x: x + 1, y: top, width: Math.max(1, pitch - 2.5), height: size, class: `bar ${kind}` });
    bar.append(titled(`episode ${verdict.episode}, step ${verdict.step}: ${verdict.outcome}`));
    parts.push(bar);
    if (verdict.truth) parts.push(mark("circle", { cx: x + pitch / 2, cy: 112, r: 3, class: "was-error" }));
  });
  svg.replaceChildren(...parts);
}

/** Whether a verdict and the truth are known, and differ. */
export function isWrong(verdict) {
  const says = { error: true, correct: false }[verdict.outcome];
  return says !== undefined && verdict.truth !== null && says !== verdict.truth;
}

export const EDGES_UV = [1, 5, 20, 50, 100];
const LANDMARKS = new Set(["Fz", "Cz", "Pz", "Oz", "C3", "C4", "T7", "T8", "Fpz"]);
const level = (uv) => EDGES_UV.filter((edge) => uv >= edge).length;

/** The head from above, each electrode as large as what it delivers; bad ones are crossed out and named. */
export function drawHead(svg, electrodes, chosen, choose) {
  svg.setAttribute("viewBox", "-1.35 -1.4 2.7 2.75");
  const parts = [
    mark("path", { d: "M-.14 -1.03L0 -1.2L.14 -1.03", class: "scalp" }),
    mark("path", { d: "M-1.04 -.2q-.12 .2 0 .4M1.04 -.2q.12 .2 0 .4", class: "scalp" }),
    mark("circle", { cx: 0, cy: 0, r: 1.04, class: "scalp" }),
  ];
  for (const { name, place, uv, faults } of electrodes) {
    if (!place) continue;
    const [x, y] = [place[0], -place[1]];
    const isBad = faults.length > 0;
    const kind = `electrode ${uv === null ? "amp-unknown" : `amp${level(uv)}`}${isBad ? " bad" : ""}`;
    const dot = mark("circle", { cx: x, cy: y, r: 0.065, class: `${kind}${name === chosen ? " chosen" : ""}` });
    dot.append(titled(`${name}: ${uv === null ? "no value" : `${uv.toFixed(1)} µV`}${isBad ? `, ${faults.join(", ")}` : ""}`));
    dot.addEventListener("click", () => choose(name));
    parts.push(dot);
    if (isBad) parts.push(mark("path", { d: `M${x - 0.07} ${y - 0.07}l.14 .14m0 -.14l-.14 .14`, class: "cross" }));
    if (isBad || LANDMARKS.has(name)) {
      const label = mark("text", { x, y: y + 0.15, class: `name${isBad ? " bad" : ""}` });
      label.append(document.createTextNode(name));
      parts.push(label);
    }
  }
  svg.replaceChildren(...parts);
}
