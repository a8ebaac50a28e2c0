// The page: two photos, an example or a webcam in; disparity, depth and points out.
const MIN_CONFIDENCE = 0.5; // of the points
const MAX_DEPTH_RATIO = 3; // points farther than this multiple of the median are left out
const FIELD_OF_VIEW = 60; // degrees, of photos whose focal length is not known

const $ = (id) => document.getElementById(id);
const photos = { left: null, right: null }; // ImageBitmap
let settings, viewer, worker, shown, stream, busy = false, lastSeconds = 0;

async function start() {
  await useServiceWorker();
  settings = await (await fetch("page.json")).json();
  viewer = makeViewer($("viewer"), settings.colours);
  $("about").textContent =
    `${settings.about}; photos are scaled to fit ${settings.width} x ${settings.height} px.`;
  worker = new Worker("worker.js", { type: "module" });
  const { provider, threads } = await ask({ settings }, "ready");
  const count = threads === 1 ? "one thread" : `${threads} threads`;
  tell(`Ready, ${provider === "webgpu" ? "on the GPU" : `on ${count}`}. Choose two photos.`);
  $("example").disabled = false;
  progress(0);
  update();
}

// Waits until the service worker serves this page, and loads it again if that gives it threads.
async function useServiceWorker() {
  const workers = navigator.serviceWorker;
  if (!workers) return; // as in private windows: one thread, and no page without a network
  try {
    await workers.register("sw.js");
    await workers.ready;
  } catch {
    return;
  }
  if (!workers.controller) {
    await new Promise((done) => workers.addEventListener("controllerchange", done, { once: true }));
  }
  if (!self.crossOriginIsolated && !sessionStorage.getItem("reloaded")) {
    sessionStorage.setItem("reloaded", "yes");
    location.reload();
    await new Promise(() => {});
  }
}

// Sends a message to the worker; gives that part of its answer, and shows its progress meanwhile.
function ask(message, part) {
  return new Promise((resolve, reject) => {
    worker.onerror = (event) => reject(new Error(event.message ?? "the worker does not start"));
    worker.onmessage = ({ data }) => {
      if (data.error) return reject(new Error(data.error));
      if (data[part]) return resolve(data[part]);
      tell(`${data.stage} ...`);
      progress(data.share);
    };
    worker.postMessage(message);
  });
}

function tell(text, failed = false) {
  $("status").textContent = text;
  $("status").classList.toggle("error", failed);
}

// A share of 1, or nothing while nobody knows.
function progress(share) {
  if (share === undefined) $("progress").removeAttribute("value");
  else $("progress").value = share;
}

function update() {
  $("match").disabled = busy || Boolean(stream) || !settings || !photos.left || !photos.right;
  $("example").disabled = busy || Boolean(stream);
  $("camera").disabled = !navigator.mediaDevices || (busy && !stream);
}

// Frees a picture that is neither chosen nor shown any more.
function release(photo) {
  if (![photos.left, photos.right, shown?.left, undefined, null].includes(photo)) photo.close();
}

async function choose(side, blob) {
  try {
    photos[side] = await createImageBitmap(blob);
  } catch {
    photos[side] = null;
    tell(`The ${side} file is no picture that this browser reads.`, true);
  }
  const image = $(side).querySelector("img");
  URL.revokeObjectURL(image.src);
  image.hidden = !photos[side];
  if (photos[side]) image.src = URL.createObjectURL(blob);
  update();
}

async function match() {
  const { left, right } = photos;
  if (left.width !== right.width || left.height !== right.height) {
    const sizes = [left, right].map((photo) => `${photo.width} x ${photo.height}`);
    return tell(`The photos must have one size: ${sizes.join(" and ")} px.`, true);
  }
  busy = true;
  update();
  const started = performance.now();
  const clock = setInterval(() => {
    const seconds = (performance.now() - started) / 1000;
    progress(lastSeconds ? Math.min(0.99, seconds / lastSeconds) : undefined);
  }, 100);
  if (!stream) tell("Matching ...");
  try {
    const result = await ask({ left, right }, "result");
    lastSeconds = (performance.now() - started) / 1000;
    tell(`Matched in ${result.seconds.toFixed(1)} s.`);
    show({ ...result, left });
  } catch (error) {
    tell(`It failed: ${error.message}`, true);
  } finally {
    clearInterval(clock);
    progress(shown ? 1 : 0);
    busy = false;
    update();
  }
}

function show(result) {
  const before = shown?.left;
  shown = result;
  release(before);
  $("result").hidden = false;
  viewer.show({ ...result, geometry: geometry() });
  dispatchEvent(new CustomEvent("matched", { detail: result })); // for scripts of one's own
  if (!$("cloud").hidden) showPoints();
}

// Of the filled-in numbers, as the viewer takes it; null where they are missing.
function geometry() {
  const [focal, baseline, doffs] = ["focal", "baseline", "doffs"].map((id) => Number($(id).value));
  if (!(focal > 0 && baseline > 0)) return null;
  const { width, height } = shown.left;
  return { focal, depth: focal * baseline, doffs, cx: (width - 1) / 2, cy: (height - 1) / 2 };
}

async function showPoints() {
  const { width, height, scale, disparity, confidence, left } = shown;
  const known = geometry();
  const { focal, depth, doffs } = known ?? {
    focal: left.width / 2 / Math.tan((FIELD_OF_VIEW * Math.PI) / 360),
    depth: left.width,
    doffs: 0,
  };
  const shifts = disparity.map((value) => value + doffs);
  const median = depth / Math.max(1e-3, shifts.slice().sort()[shifts.length >> 1]);
  const chosen = [];
  for (let i = 0; i < shifts.length; i++) {
    const far = shifts[i] <= 0 || depth / shifts[i] > MAX_DEPTH_RATIO * median;
    if (!far && disparity[i] > 0 && !(confidence?.[i] < MIN_CONFIDENCE)) chosen.push(i);
  }
  const positions = new Float32Array(3 * chosen.length);
  const colours = new Uint8Array(3 * chosen.length);
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(left, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height);
  chosen.forEach((i, point) => {
    const z = depth / shifts[i];
    const x = ((((i % width) - (width - 1) / 2) / scale) * z) / focal;
    const y = (((Math.floor(i / width) - (height - 1) / 2) / scale) * z) / focal;
    positions.set([x, -y, -z], 3 * point);
    colours.set(data.subarray(4 * i, 4 * i + 3), 3 * point);
  });
  $("cloud").hidden = $("cloud-note").hidden = false;
  $("show-cloud").hidden = true;
  $("cloud-note").textContent =
    `${chosen.length} points. Drag to turn, scroll or pinch to come closer.` +
    (known ? "" : ` The shape supposes a field of view of ${FIELD_OF_VIEW} degrees.`);
  const angle = (360 / Math.PI) * Math.atan(left.height / 2 / focal);
  const { showCloud } = await import("./cloud.js");
  const view = { angle, columns: width, distance: median, stay: Boolean(stream) };
  showCloud($("cloud"), positions, colours, view);
}

async function useExample() {
  const { example } = settings;
  for (const side of ["left", "right"]) await choose(side, await (await fetch(example[side])).blob());
  for (const id of ["focal", "baseline", "doffs"]) $(id).value = example[id];
  await match();
}

async function useCamera() {
  if (stream) return stopCamera();
  try {
    stream = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 2560 } } });
  } catch (error) {
    return tell(`No camera: ${error.message}`, true);
  }
  const video = $("video");
  video.srcObject = stream;
  video.hidden = false;
  $("camera").textContent = "Stop the webcam";
  await video.play();
  while (stream) {
    const half = video.videoWidth >> 1, height = video.videoHeight;
    const before = { ...photos };
    photos.left = await createImageBitmap(video, 0, 0, half, height);
    photos.right = await createImageBitmap(video, half, 0, half, height);
    Object.values(before).forEach(release);
    await match();
  }
}

function stopCamera() {
  stream.getTracks().forEach((track) => track.stop());
  stream = null;
  $("video").hidden = true;
  $("camera").textContent = "Side-by-side webcam";
  update();
}

for (const side of ["left", "right"]) {
  const input = $(side).querySelector("input");
  input.addEventListener("change", () => input.files[0] && choose(side, input.files[0]));
}
$("match").addEventListener("click", match);
$("example").addEventListener("click", useExample);
$("camera").addEventListener("click", useCamera);
$("show-cloud").addEventListener("click", showPoints);
for (const id of ["focal", "baseline", "doffs"]) {
  $(id).addEventListener("change", () => shown && viewer.show({ ...shown, geometry: geometry() }));
}

start().catch((error) => tell(`It cannot start: ${error.message}`, true));
