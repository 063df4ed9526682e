// The page: asks the coordinator it came from for its state, and for the tiles that changed; shows both. Everything is asked for
// with `fetch` and a token in a header, never with cookies, so that no other site's page can ask in its reader's name.

import { Picture, ramp } from "./image.js";
import { Plot } from "./plot.js";
import { clock, count, duration, fill, measured, percent, set } from "./tables.js";

const RETRY_MIN = 500, RETRY_MAX = 5000;
// The picture is fetched at most twice a second, and progress is read out at most this often, in milliseconds.
const PICTURE_PAUSE = 500, SPEAK_PAUSE = 10000;

const $ = (id) => document.getElementById(id);
const picture = new Picture($("picture"), read);
const plot = new Plot($("plot"));

let state = null;
// The job that is shown; `chosen` if by hand, else it is the newest that runs.
let shown = { id: null, chosen: false, instance: null, version: 0, fetching: false, state: null, rounds: -1 };
let spoken = { at: 0, text: "" };

// ---- talking to the coordinator

const fragment = new URLSearchParams(location.hash.slice(1)).get("token");
if (fragment) {
  sessionStorage.setItem("token", fragment);
  history.replaceState(null, "", location.pathname);
}

async function ask(path, options = {}) {
  const token = sessionStorage.getItem("token");
  const headers = { "x-tilecast": "1", ...(token ? { authorization: `Bearer ${token}` } : {}) };
  const answer = await fetch(path, { ...options, headers });
  if (answer.status === 401) {
    await identify();
    return ask(path, options);
  }
  if (!answer.ok) throw Object.assign(new Error((await answer.text()).trim() || answer.statusText), { status: answer.status });
  return answer;
}

let asking = null;
function identify() {
  const dialog = $("ask");
  asking ??= new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      sessionStorage.setItem("token", $("token").value.trim());
      asking = null;
      resolve();
    }, { once: true });
    dialog.showModal();
  });
  return asking;
}

async function follow() {
  let pause = RETRY_MIN;
  for (;;) {
    try {
      const reader = (await ask("/api/live")).body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        text += value;
        const events = text.split("\n\n");
        text = events.pop();
        // Of those that piled up only the last one is true.
        const data = events.map((event) => event.match(/^data: (.*)$/m)?.[1]).filter(Boolean).at(-1);
        if (data) {
          pause = RETRY_MIN;
          update(JSON.parse(data));
        }
      }
    } catch (error) {
      if (error.status) console.info(error.message);
    }
    link(false, state?.ending ? "the coordinator has ended" : "no connection, trying again");
    await new Promise((resolve) => setTimeout(resolve, pause));
    pause = Math.min(RETRY_MAX, pause * 1.5);
  }
}

function link(on, text) {
  $("link").className = `link ${on ? "on" : "off"}`;
  set("link", text);
}

// ---- what came

function update(next) {
  state = next;
  link(!next.ending, next.ending ? "the coordinator ends" : "live");
  set("title", next.title ? `tilecast · ${next.title}` : "tilecast");
  choose();
  const job = current();
  progress(job);
  tables();
  refresh();
}

const current = () => state?.jobs.find((job) => job.id === shown.id) ?? null;
const goesOn = (job) => job.state === "running" || job.state === "queued";
const label = (job) => `${job.id} ${job.name || state.title || ""}`.trim();

function choose() {
  const select = $("job"), wanted = state.jobs.find((job) => job.state === "running") ?? state.jobs[0];
  const gone = !current();
  if ((!shown.chosen || gone) && wanted && (gone || !goesOn(current()) || wanted.state === "running")) view(wanted.id, false);
  const options = state.jobs.map((job) => `${label(job)} (${job.state})`);
  if (options.length === 0) return;
  if (select.length !== options.length || state.jobs.some((job, i) => select[i].value !== String(job.id))) {
    select.replaceChildren(...state.jobs.map((job, i) => new Option(options[i], job.id)));
  }
  options.forEach((text, i) => {
    if (select[i].text !== text) select[i].text = text;
  });
  select.value = String(shown.id);
}

function view(id, chosen) {
  if (id === shown.id) return void (shown.chosen ||= chosen);
  shown = { id, chosen, instance: null, version: 0, fetching: false, state: null, rounds: -1 };
  picture.clear();
  plot.clear();
  if (state) update(state);
}

// ---- the picture

async function refresh() {
  const here = shown, job = current();
  $("empty").hidden = Boolean(job);
  if (!job || here.fetching) return;
  // Another coordinator counts versions anew; what it has of the same job goes over what is there.
  if (here.instance !== state.instance) Object.assign(here, { instance: state.instance, version: 0 });
  if (job.version !== null && job.version <= here.version) return;
  if (job.version === null && here.version > 0) return;
  here.fetching = true;
  try {
    for (let more = true; more && here === shown;) {
      const answer = await ask(`/api/jobs/${here.id}/tiles/${here.instance}/${here.version}`);
      const buffer = await answer.arrayBuffer();
      if (here !== shown) return;
      ({ version: here.version, more } = picture.take(buffer));
    }
    set("empty", "");
    legend();
    const error = picture.relativeError(), now = current();
    if (now && error) plot.add(now.running, whole(now).scaled(error, now.samples_done));
    if (!state.ending) await new Promise((resolve) => setTimeout(resolve, PICTURE_PAUSE));
  } catch (error) {
    // Lost connections are told by the feed; a film that is gone is gone.
    if (error.status === 404 && here === shown) set("empty", error.message);
    await new Promise((resolve) => setTimeout(resolve, 2 * PICTURE_PAUSE));
  } finally {
    here.fetching = false;
  }
  if (here === shown && current()?.version > here.version) refresh();
}

function read(reading, aloud) {
  set("zoom", picture.scale ? `${Number((100 * picture.scale).toPrecision(3))} %` : "–");
  if (!reading) return;
  const { x, y, channels, count: samples, relative } = reading;
  const values = samples > 0
    ? `${channels.map(({ mean, error }, i) => `${"RGB"[i]} ${measured(mean, error)}`).join("   ")}   ${samples.toLocaleString("en")} samples${Number.isFinite(relative) ? `   relative error ${percent(relative, 2)}` : ""}`
    : "no samples yet";
  set("readout", `(${x}, ${y})   ${values}`);
  if (aloud) set("spoken", `Pixel ${x}, ${y}: ${values}`);
}

function legend() {
  const ends = picture.legend();
  $("legend").hidden = !ends;
  if (ends) set("low", ends[0]), set("high", ends[1]);
}

// ---- progress

// The image that a job is a step towards: steps before it are not in this picture, but count for its error, which goes with the
// root of the number of samples. A pilot is no part of the image.
function whole(job) {
  const { before, image, expected, pilot } = job.aim ?? { before: 0, image: 0, expected: 0, pilot: false };
  const share = (samples) => Math.sqrt(samples / Math.max(1, image + samples));
  return {
    fraction: (before + job.samples_done) / Math.max(1, expected, before + job.samples_total),
    scaled: (error, samples) => (pilot ? null : error * share(samples)),
    error: job.error && !pilot ? job.error.map((error) => error * share(job.samples_done)) : null,
  };
}

function progress(job) {
  const { fraction, error } = job ? whole(job) : { fraction: 0 };
  $("bar").value = fraction;
  document.title = job && goesOn(job) ? `${Math.floor(100 * fraction)} % · tilecast` : "tilecast";
  if (!job) return;
  const left = goesOn(job) && job.seconds_left !== null ? duration(job.seconds_left) : "–";
  const done = job.state === "running" ? `${(100 * fraction).toFixed(1)} %` : `${Math.floor(100 * fraction)} %, ${job.aim ? "step " : ""}${job.state}`;
  set("done", done);
  set("left", left);
  set("error", error ? percent(error[0]) : "not known yet");
  set("interval", error ? `${percent(error[1], 2)} to ${percent(error[2], 2)}` : job.aim?.pilot ? "a pilot looks where the noise is" : "");
  const target = job.aim?.target, ofAll = job.aim?.of === "image";
  const expected = error && goesOn(job) && !job.aim ? error[0] * Math.sqrt(fraction) : null;
  set("goalname", target ? "Target" : expected ? "Expected at the end" : "Samples a pixel");
  set("goal", target || expected ? percent(target || expected) : job.spp.toLocaleString("en"));
  set("goalspp", target ? (ofAll ? "of the whole image" : "of 95 % of the pixels") : expected ? `with ${job.spp.toLocaleString("en")} samples a pixel` : "");
  set("rate", job.samples_per_second > 0 ? count(job.samples_per_second) : "–");
  set("running", job.running > 0 ? duration(job.running) : "–");
  const goal = target && ofAll ? target : expected;
  plot.aim(goal, goal && job.seconds_left !== null ? job.running + job.seconds_left : null);
  speak(job, done, left);
  rounds(job);
}

// Progress as a sentence, now and then, for who hears the page.
function speak(job, done, left) {
  const ended = shown.state !== null && shown.state !== job.state;
  shown.state = job.state;
  if (!ended && Date.now() - spoken.at < SPEAK_PAUSE) return;
  const known = whole(job).error, aimed = job.aim?.target ? ` of ${percent(job.aim.target, 2)} wanted` : "";
  const error = known ? `, error ${percent(known[0], 2)}${aimed}` : "";
  const text = goesOn(job) ? `Job ${label(job)}: ${done} done${error}, ${left} left, ${job.workers} workers` : `Job ${label(job)} is ${job.state}${error}`;
  if (text === spoken.text) return;
  spoken = { at: Date.now(), text };
  set("summary", text);
}

// Fetches the way of the error when another point was added to it.
async function rounds(job) {
  const here = shown, mark = job.error ? job.error.join() : "";
  if (mark === here.rounds || mark === "") return;
  here.rounds = mark;
  try {
    const detail = await (await ask(`/api/jobs/${job.id}`)).json();
    const { scaled } = whole(job);
    if (here === shown) plot.setRounds(detail.history.map(([at, samples, error]) => [at, samples, error.map((e) => scaled(e, samples))]));
  } catch {
    here.rounds = -1;
  }
}

// ---- tables

function tables() {
  set("workercount", state.workers_total ? `${state.workers_total}, ${state.threads_total} threads` : "");
  set("jobcount", state.jobs_total > state.jobs.length ? `the last ${state.jobs.length} of ${state.jobs_total}` : "");
  fill($("workers"), state.workers, (one) => one.id, (one) => [
    [`${one.name ? `${one.name} on ` : ""}${one.host || "?"} · ${one.id}`, ""],
    [String(one.threads), "n"],
    [one.samples_per_second > 0 ? count(one.samples_per_second) : "–", "n"],
    [one.units.toLocaleString("en"), "n"],
    [String(one.leases), "n"],
    [`${one.silent.toFixed(1)} s ago`, one.silent > 2.5 ? "n bad" : "n"],
    [`${{ no: "not", all: "everything", some: "proven, some" }[one.checked]}${one.offences ? `, ${one.offences} wrong` : ""}`, one.offences ? "bad" : ""],
  ], (line, one) => line.title = `${one.cpu} · ${one.isa}`);
  fill($("jobs"), state.jobs, (job) => job.id, (job, line) => [
    [label(job), ""],
    [clock(job.submitted), ""],
    [job.why ? `${job.state}: ${job.why}` : job.state, { finished: "good", failed: "bad wrap", cancelled: "warm" }[job.state] ?? ""],
    [percent(Math.floor(1000 * job.samples_done / Math.max(1, job.samples_total)) / 1000), "n"],
    [whole(job).error ? percent(whole(job).error[0], 2) : "–", "n"],
    [goesOn(job) && job.seconds_left !== null ? duration(job.seconds_left) : "–", "n"],
    line.buttons ??= buttons(job),
  ], (line, job) => {
    line.className = job.id === shown.id ? "chosen" : "";
    line.buttons.lastChild.hidden = !goesOn(job);
  });
  fill($("events"), [...state.events].reverse(), (event) => event.number, (event) => [
    [clock(event.at), ""],
    [event.text, `wrap ${["worker_silent", "leases_lapsed", "unit_failed"].includes(event.kind) ? "warm" : ["job_failed", "unit_set_aside", "nonsense", "shut_out", "convicted"].includes(event.kind) ? "bad" : ""}`],
  ]);
}

function buttons(job) {
  const both = document.createElement("span");
  for (const [text, act] of [["Show", () => view(job.id, true)], ["Cancel", () => cancel(job)]]) {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: text });
    button.setAttribute("aria-label", `${text} job ${label(job)}`);
    button.addEventListener("click", act);
    both.append(button, " ");
  }
  both.lastChild.remove();
  return both;
}

function cancel(job) {
  const dialog = $("sure");
  set("question", `Cancel job ${label(job)}? What is done of it is dropped.`);
  dialog.returnValue = "no";
  dialog.addEventListener("close", async () => {
    if (dialog.returnValue !== "yes") return;
    try {
      await ask(`/api/jobs/${job.id}/cancel`, { method: "POST" });
    } catch (error) {
      link(true, `not cancelled: ${error.message}`);
    }
  }, { once: true });
  dialog.showModal();
}

// ---- hands

function show(map) {
  document.querySelector(`input[name=map][value=${map}]`).checked = true;
  picture.show(map);
  legend();
}

function expose(stops) {
  $("exposure").value = stops;
  const value = Number($("exposure").value);
  set("stops", `${value > 0 ? "+" : ""}${value} EV`);
  picture.expose(value);
}

document.querySelectorAll("input[name=map]").forEach((input) => input.addEventListener("change", () => show(input.value)));
$("exposure").addEventListener("input", (event) => expose(event.target.value));
$("in").addEventListener("click", () => picture.zoom(2 ** 0.5));
$("out").addEventListener("click", () => picture.zoom(2 ** -0.5));
$("fit").addEventListener("click", () => picture.fit());
$("one").addEventListener("click", () => picture.one());
$("job").addEventListener("change", (event) => view(Number(event.target.value), true));
$("picture").addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const map = { i: "image", e: "error", s: "samples" }[event.key], step = { "[": -0.5, "]": 0.5 }[event.key];
  if (map) show(map);
  else if (step) expose(Number($("exposure").value) + step);
  else if (!picture.key(event)) return;
  event.preventDefault();
});

const bar = $("ramp").getContext("2d"), strip = bar.createImageData(256, 1);
ramp.forEach((colour, i) => strip.data.set([...colour, 255], 4 * i));
bar.putImageData(strip, 0, 0);

follow();
