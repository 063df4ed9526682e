// The live page in a real browser, against a real coordinator with two workers, from a job's beginning through a killed worker and
// a killed coordinator to its end. `just view` runs it; it needs node, chromium and playwright-core, and says what it saw.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { createRequire } from "node:module";

const root = path.resolve(import.meta.dirname, "../..");
const { chromium } = createRequire(path.join(process.env.PLAYWRIGHT ?? process.cwd(), "x.js"))("playwright-core");
const tilecast = process.env.TILECAST ?? path.join(root, "target/release/tilecast");
const pictures = process.env.PICTURES;
const PATIENCE = 120_000;
const folder = mkdtempSync(path.join(tmpdir(), "tilecast-view-"));
const children = new Set();

function start(...args) {
  const child = spawn(tilecast, args, { cwd: folder, stdio: ["ignore", "pipe", "pipe"] });
  children.add(child);
  child.said = "";
  child.stdout.on("data", (data) => child.said += data);
  child.stderr.on("data", (data) => child.said += data);
  child.over = new Promise((resolve) => child.on("exit", (code) => resolve(code)));
  return child;
}

async function until(what, look) {
  for (const begun = Date.now(); ;) {
    const seen = await look();
    if (seen) return seen;
    assert(Date.now() - begun < PATIENCE, `waited for ${what} in vain`);
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

const event = (child, name) => until(name, () => {
  const lines = child.said.split("\n").filter((line) => line.startsWith("{")).map((line) => JSON.parse(line));
  return lines.find((line) => line.event === name);
});

async function kill(child, signal) {
  child.kill(signal);
  await child.over;
}

function step(text) {
  console.log(`ok: ${text}`);
}

const scene = path.join(root, "scenes/cornell-box/scene.xml");
async function run() {
  let coordinator = start("coordinator", "--json", "--listen", "127.0.0.1:0", "--http", "127.0.0.1:0", "--state", "state");
  const { address } = await event(coordinator, "listening");
  const { url } = await event(coordinator, "viewing");
  const worker = (name) => start("worker", "--connect", address, "--threads", "1", "--name", name);
  let alpha = worker("alpha");
  worker("beta");
  const submit = (spp, ...more) => start("submit", scene, "--json", "--connect", address, "--size", "320x320", ...(spp ? ["--spp", spp] : []), ...more);
  const job = submit("1000");

  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
  const page = await browser.newPage({ viewport: { width: 1280, height: 900 }, colorScheme: "light" });
  const wrong = [], sizes = new Map();
  let expected = false;
  page.on("pageerror", (error) => wrong.push(error.message));
  page.on("console", (message) => {
    // What a browser says of a coordinator that was killed is not the page's.
    if (message.type() === "error" && !(expected && /ERR_|Failed to load resource/.test(message.text()))) wrong.push(message.text());
  });
  page.on("request", (request) => request.url().startsWith(url) || wrong.push(`a request to ${request.url()}`));
  page.on("response", async (response) => {
    const { pathname } = new URL(response.url());
    if (!pathname.startsWith("/api/")) sizes.set(pathname, (await response.body().catch(() => [])).length);
  });
  await page.goto(url);

  // The picture as its canvas has it: how much of it is known, and how rough it is.
  const look = () => page.evaluate(() => {
    const { width, height } = document.getElementById("picture"), scratch = new OffscreenCanvas(width, height).getContext("2d");
    scratch.drawImage(document.getElementById("picture"), 0, 0);
    const { data } = scratch.getImageData(0, 0, width, height);
    let known = 0, rough = 0, bright = 0, n = 0;
    for (let y = 0; y < height; y += 3) for (let x = 0; x < width - 3; x += 3, n++) {
      const i = 4 * (y * width + x), grey = data[i] + data[i + 1] + data[i + 2], next = data[i + 8] + data[i + 9] + data[i + 10];
      known += data[i + 3] > 0 && !(data[i] === 52 && data[i + 1] === 54);
      bright += grey / 3;
      rough += Math.abs(grey - next);
    }
    return { known: known / n, rough: rough / n, bright: bright / n };
  });
  const text = (id) => page.textContent(`#${id}`);
  const done = async () => parseFloat(await text("done"));

  const first = await until("the image", async () => (await done()) > 0 && (await look()).known > 0.5 && look());
  step(`the image appears: ${(100 * first.known).toFixed(0)} % of the canvas`);
  const error = await until("an error", async () => /%/.test(await text("error")) && parseFloat(await text("error")));
  const sharper = await until("a sharper image", async () => {
    const now = await look();
    return parseFloat(await text("error")) < error / 2 && now.rough < first.rough && now;
  });
  step(`it sharpens: error ${error} % to ${await text("error")}, neighbours differ by ${first.rough.toFixed(1)}, then ${sharper.rough.toFixed(1)}`);
  assert.match(await text("summary"), /done/, "progress is a sentence, too");
  assert.equal(await page.getAttribute("#summary", "aria-live"), "polite");
  await until("both workers", async () => (await page.locator("#workers tbody tr").count()) === 2);

  // By keyboard alone: from the top of the page to the picture, then its keys.
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await page.focus("#picture");
  const before = await text("zoom");
  await page.keyboard.press("+");
  await until("a zoom by key", async () => (await text("zoom")) !== before);
  await page.keyboard.press("Shift+ArrowRight");
  await until("a pixel read out", async () => /Pixel \d+, \d+: R .* ± .*samples/.test(await text("spoken")));
  await page.keyboard.press("]");
  await page.keyboard.press("]");
  assert.equal(await text("stops"), "+1 EV");
  await until("a brighter image", async () => (await look()).bright > sharper.bright * 1.1);
  await page.keyboard.press("0");
  await page.mouse.move(400, 400);
  await page.mouse.wheel(0, -480);
  await until("a zoom by wheel", async () => (await text("zoom")) !== before);
  await until("a value under the pointer", async () => /\(\d+, \d+\).*±.*samples/.test(await text("readout")));
  step(`zoom, exposure and pixel values: ${await text("readout")}`);
  await page.focus("#picture");
  for (const key of ["0", "[", "["]) await page.keyboard.press(key);
  const keep = async (name) => {
    if (!pictures) return;
    await page.evaluate(() => scrollTo(0, 0));
    await page.screenshot({ path: path.join(pictures, `live-${name}.png`) });
  };
  await keep("light");
  const image = await look();
  await page.keyboard.press("e");
  const map = await until("the map of errors", async () => {
    const now = await look();
    return Math.abs(now.bright - image.bright) > 2 && now;
  });
  assert.equal(await page.isVisible("#legend"), true);
  await page.emulateMedia({ colorScheme: "dark" });
  await keep("dark");
  await page.keyboard.press("s");
  await until("the map of samples", async () => Math.abs((await look()).bright - map.bright) > 2);
  await page.keyboard.press("i");
  step("maps of errors and of samples");

  await kill(alpha, "SIGKILL");
  await until("one worker less", async () => (await page.locator("#workers tbody tr").count()) === 1);
  await until("its end among the events", async () => /alpha .* is not heard any more/.test(await text("events")));
  alpha = worker("alpha");
  await until("it back", async () => (await page.locator("#workers tbody tr").count()) === 2);
  step("a worker is killed and comes back");

  const until_then = await done();
  expected = true;
  await kill(coordinator, "SIGKILL");
  await until("the page to notice", async () => /no connection/.test(await text("link")));
  assert((await look()).known > 0.3, "the picture stays");
  coordinator = start("coordinator", "--json", "--listen", address, "--http", new URL(url).host, "--state", "state");
  await event(coordinator, "viewing");
  await until("the page back", async () => (await text("link")) === "live");
  expected = false;
  const then = await until("the job to go on", async () => (await done()) > until_then && done());
  step(`the coordinator is killed and started again: ${until_then} %, then ${then} %`);

  await page.setViewportSize({ width: 390, height: 844 });
  const wide = await page.evaluate(() => document.documentElement.scrollWidth);
  assert(wide <= 390, `${wide} pixels wide on a phone`);
  await keep("phone");
  await page.setViewportSize({ width: 1280, height: 900 });

  const second = submit("1000000", "-o", "second.exr");
  const cancel = page.locator("#jobs tbody tr", { hasText: /^2 / }).getByRole("button", { name: /Cancel/ });
  await cancel.click();
  await page.keyboard.press("Escape");
  assert.equal(await page.locator("#jobs tbody tr", { hasText: "cancelled" }).count(), 0, "not without asking");
  await cancel.click();
  await page.getByRole("button", { name: "Cancel the job" }).click();
  assert.equal(await second.over, 1);
  await until("the job cancelled", async () => (await page.locator("#jobs tbody tr", { hasText: "cancelled" }).count()) === 1);
  step("a job is cancelled, after a question");

  assert.equal(await job.over, 0, job.said);
  await until("its end on the page", async () => /100 %, finished/.test(await text("done")) || page.selectOption("#job", "1").then(() => false));
  step("the first job is finished and written");

  const seeking = submit(null, "--target-error", "0.02", "-o", "third.exr");
  // A page that nobody has chosen a job on goes from step to step.
  await page.reload();
  await until("a step of an image with a target", async () => (await text("goalname")) === "Target");
  assert.deepEqual([await text("goal"), await text("goalspp")], ["2 %", "of the whole image"]);
  const near = await until("an error near the target", async () => parseFloat(await text("error")) < 4 && text("error"));
  await keep("target");
  assert.equal(await seeking.over, 0, seeking.said);
  step(`an image with a target error of 2 % gets there: ${near} on the way`);

  const bytes = [...sizes.values()].reduce((a, b) => a + b, 0);
  assert(bytes <= 300_000, `${bytes} bytes`);
  step(`page and scripts are ${bytes} bytes in ${sizes.size} files; no request beyond the origin, no error on the console`);
  await browser.close();
  assert.deepEqual(wrong, []);
}

try {
  await run();
} finally {
  children.forEach((child) => child.kill("SIGKILL"));
  rmSync(folder, { recursive: true, force: true });
}
