// The page: hears what changed from the console's process, shows it, and sends what is asked for.

import { EDGES_UV, drawBars, drawHead, drawWorld, isWrong } from "./drawings.js";
import { Responses } from "./responses.js";

const LOST_MS = 4000; // without a word of the console's process, which speaks every second
const MOST_BARS = 60;
const $ = (id) => document.getElementById(id);
const known = {};
let heardAt = performance.now();
let ended = false;

const responses = new Responses($("plot"), $("channel"), $("epochs"), () => drawElectrodes());

// Words and numbers.

const fixed = (value, digits = 1) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const percent = (share) => (share === null || share === undefined ? "–" : `${(100 * share).toFixed(1)} %`);
const set = (id, text) => { if ($(id).textContent !== text) $(id).textContent = text; };
const clock = (seconds) => {
  const whole = Math.max(0, Math.round(seconds));
  const parts = [Math.floor(whole / 60) % 60, whole % 60].map((part) => String(part).padStart(2, "0"));
  return (whole >= 3600 ? `${Math.floor(whole / 3600)}:` : "") + parts.join(":");
};

function cells(row, ...values) {
  for (const value of values) {
    const cell = document.createElement("td");
    const [text, kind, small] = Array.isArray(value) ? value : [value];
    cell.textContent = text;
    if (kind) cell.className = kind;
    if (small) cell.append(Object.assign(document.createElement("small"), { textContent: small }));
    row.append(cell);
  }
  return row;
}
const row = (...values) => cells(document.createElement("tr"), ...values);

// Each section of the snapshot has a function that shows it.

const show = {
  session(session) {
    const phase = ended || session.phase === "looking" ? "looking" : session.phase;
    $("phase").dataset.phase = phase;
    set("phase", phase === "looking" ? `waiting for ${session.waits_for}` : session.pause ? `paused: ${session.pause}` : session.end ? `ended: ${session.end}` : phase);
    set("participant", session.participant ?? "Console");
    const speed = session.speed && session.speed !== 1 ? `, ${session.speed} times real speed` : "";
    set("what", session.task ? `${session.task} on ${session.map}${speed}` : "");
    set("session", session.id ? `Session ${session.id}` : "");
    document.title = session.participant ? `${session.participant} · ${phase}` : "Console";
    for (const name of ["pause", "resume", "finish"]) allow(name, session.can?.[name]);
    allow("send", session.can?.note);
    set("finish", session.task === "calibration" ? "End after this block" : "End after this episode");
    set("message", messageOf(session));
  },
  progress(progress) {
    const { done, total, unit } = progress;
    $("bar").max = total || 1;
    $("bar").value = Math.min(done ?? 0, total || 1);
    set("done", total ? `${done} of ${total} ${unit}` : "–");
    const block = progress.n_blocks ? `block ${progress.block ?? "–"} of ${progress.n_blocks}, ` : "";
    set("where", total ? `· ${block}episode ${progress.episode ?? "–"}, move ${progress.step}${progress.max_steps ? ` of ${progress.max_steps}` : ""}` : "");
    set("clock", progress.elapsed_s === null ? "" : `· ${clock(progress.elapsed_s)}`);
    set("to_go", progress.to_go_s === null ? "" : `about ${clock(progress.to_go_s)} to go`);
  },
  world: () => drawMap(),
  episode: () => drawMap(),
  verdicts(verdicts) {
    const { n } = verdicts;
    set("accuracy", n ? `${percent(verdicts.accuracy)} of ${n}` : "–");
    set("balanced", percent(verdicts.balanced_accuracy));
    set("hits", n ? `${verdicts.hits} of ${verdicts.hits + verdicts.misses}` : "–");
    set("rejections", n ? `${verdicts.correct_rejections} of ${verdicts.correct_rejections + verdicts.false_alarms}` : "–");
    set("rejected", String(verdicts.rejected));
    set("unjudged", String(verdicts.unjudged));
    const scored = verdicts.recent.some((verdict) => verdict.log_odds !== null);
    $("bars").classList.toggle("away", !scored);
    $("bars_key").classList.toggle("away", !scored);
    if (scored) drawBars($("bars"), verdicts.recent, MOST_BARS);
    const told = { true: "error", false: "correct", null: "–" };
    $("rows").replaceChildren(...verdicts.recent.slice(-20).reverse().map((verdict) => row(
      `${verdict.episode + 1}.${verdict.step}`,
      [isWrong(verdict) ? `${verdict.outcome}, wrong` : verdict.outcome, `${verdict.outcome}${isWrong(verdict) ? " wrong" : ""}`, verdict.reason],
      [told[verdict.truth], told[verdict.truth]],
      fixed(verdict.log_odds, 2), fixed(verdict.evidence, 2), fixed(verdict.latency_ms, 1),
    )));
  },
  episodes(episodes) {
    set("n_episodes", String(episodes.n));
    set("success", percent(episodes.success));
    set("mean_steps", fixed(episodes.mean_steps, 2));
  },
  latency(latency) {
    const ledger = { "last sample – verdict": latency.verdict, "verdict – action": latency.action };
    $("latency").replaceChildren(...Object.entries(ledger).map(([name, of]) => row(
      name, String(of.n), fixed(of.p50_ms, 2), fixed(of.p99_ms, 2), fixed(of.last_ms, 2))));
    set("frames", latency.late_frames ? `${latency.late_frames} late pictures, the worst by ${fixed(latency.worst_frame_ms)} ms` : "No late picture.");
  },
  streams(streams) {
    $("streams").replaceChildren(...streams.map((stream) => row(
      stream.stream, [stream.state, stream.state], fixed(stream.age_s), fixed(stream.rate_hz),
      stream.heard_by.map(linkOf).join("; ") || "–")));
  },
  head(head) {
    const bad = Object.entries(head.bad).map(([name, faults]) => `${name} (${faults.join(", ")})`);
    set("bad", head.electrodes.length ? (bad.length ? `bad: ${bad.join(", ")}` : `${head.electrodes.length}, none bad`) : "");
    drawElectrodes();
  },
  average: (average) => responses.update(average),
  log(log) {
    $("log").replaceChildren(...log.slice().reverse().map((line) => {
      const item = document.createElement("li");
      item.className = line.role === "console" ? `${line.level} person` : line.level;
      const time = Object.assign(document.createElement("time"), { textContent: line.t === null ? "before" : line.t < 0 ? `−${clock(-line.t)}` : clock(line.t) });
      const role = Object.assign(document.createElement("b"), { textContent: line.role });
      item.append(time, role, Object.assign(document.createElement("span"), { textContent: line.text }));
      return item;
    }));
  },
};

function linkOf(link) {
  const parts = [`${link.role} ${fixed(link.age_s)} s`];
  if (link.rate_hz !== null) parts.push(`${fixed(link.rate_hz)} Hz`);
  if (link.gaps) parts.push(`${link.gaps} gaps`);
  if (link.reconnects) parts.push(`${link.reconnects} reconnects`);
  if (Math.abs(link.offset_s ?? 0) >= 5e-5) parts.push(`clock ${(1000 * link.offset_s).toFixed(1)} ms`);
  return parts.join(", ");
}

function messageOf(session) {
  if (session.asked === "pause") return "Pause is asked for: it begins after the move under way.";
  if (session.asked === "resume" && session.phase === "paused") return "Resume is asked for: it goes on once all else is well.";
  if (session.is_last && session.phase !== "ended") return "The run ends after what is under way.";
  if (session.phase !== "looking" && !session.is_led && session.phase !== "ended") return "No bci-app leads this session: the buttons do nothing.";
  if (session.is_late) return "This console came later: its figures begin with the episode that was under way then.";
  if (session.screen) return `The participant sees: ${session.screen}.`;
  return "";
}

function allow(id, yes) { $(id).setAttribute("aria-disabled", String(!yes)); }

function drawMap() {
  const { world, episode } = known;
  if (!world) return;
  drawWorld($("world"), world.layout, episode);
  const belief = episode?.belief;
  set("belief_key", belief ? (belief.exact ? "belief by Bayes' rule" : "the policy's belief") : "no belief");
  set("episode", episode ? `episode ${episode.episode + 1}${episode.distance === null ? "" : `, distance ${episode.distance}`}` : "");
  const goal = episode?.goal ? `goal at row ${episode.goal[0]}, column ${episode.goal[1]}` : "goal not heard of";
  $("world").setAttribute("aria-label", episode ? `Map: agent at row ${episode.agent[0]}, column ${episode.agent[1]}, ${goal}, ${episode.path.length} moves` : "Map: no episode yet");
}

function drawElectrodes() {
  const electrodes = known.head?.electrodes ?? [];
  drawHead($("head"), electrodes, responses.channel, (name) => responses.choose(name));
  if (electrodes.length) $("head").setAttribute("aria-label", `Head map of ${electrodes.length} electrodes, ${Object.keys(known.head.bad).length} bad`);
}

// What is asked for.

async function ask(body) {
  let answer;
  try {
    answer = await fetch("ask", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  } catch {
    set("message", "Not sent: the console doesn't answer. P at the stimulus pauses.");
    return false;
  }
  if (!answer.ok) set("message", (await answer.json().catch(() => ({ error: "It was refused." }))).error);
  return answer.ok;
}

const isAllowed = (id) => $(id).getAttribute("aria-disabled") === "false";
for (const name of ["pause", "resume"]) $(name).addEventListener("click", () => isAllowed(name) && ask({ command: name }));
$("finish").addEventListener("click", () => isAllowed("finish") && $("sure").showModal());
$("sure").addEventListener("close", () => { if ($("sure").returnValue === "yes") ask({ command: "finish" }); $("sure").returnValue = ""; });
$("note_form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const note = $("note").value.trim();
  if (note && isAllowed("send") && (await ask({ note }))) $("note").value = "";
});

// What is heard.

const events = new EventSource("events");
events.onmessage = (event) => {
  heardAt = performance.now();
  const news = JSON.parse(event.data);
  Object.assign(known, news);
  for (const name of Object.keys(news)) show[name]?.(news[name]);
};
events.addEventListener("end", () => { ended = true; events.close(); lost("The console has ended. What was shown last stays."); });

function lost(text) {
  $("phase").dataset.phase = "lost";
  set("phase", text);
  for (const name of ["pause", "resume", "finish", "send"]) allow(name, false);
}
setInterval(() => {
  const isLost = !ended && performance.now() - heardAt > LOST_MS;
  if (isLost) lost("Cut off from the console; trying again.");
  else if ($("phase").dataset.phase === "lost" && !ended && known.session) show.session(known.session);
}, 1000);

for (const [index, edge] of [0, ...EDGES_UV].entries()) {
  const name = index === 0 ? `below ${EDGES_UV[0]}` : index === EDGES_UV.length ? `${edge} µV or more` : `${edge}`;
  $("head_key").append(Object.assign(document.createElement("span"), { className: `k amp amp${index}`, textContent: name }));
}
drawHead($("head"), [], null, () => {});
