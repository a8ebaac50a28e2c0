// Matches pairs in ONNX Runtime: on WebGPU where there is one, else in WebAssembly.
let ort, session, settings;

self.onmessage = async ({ data }) => {
  try {
    if (data.settings) await load(data.settings);
    else await match(data.left, data.right);
  } catch (error) {
    self.postMessage({ error: String(error.message ?? error) });
  }
};

async function load(given) {
  settings = given;
  const model = await download(settings.model, settings.bytes);
  const provider = await open(model, (await hasDevice()) ? ["webgpu", "wasm"] : ["wasm"]);
  self.postMessage({ ready: { provider, threads: ort.env.wasm.numThreads } });
}

// Whether WebGPU gives a device: an adapter alone may have none, and the runtime waits for it in vain.
async function hasDevice() {
  try {
    const adapter = await navigator.gpu.requestAdapter();
    (await adapter.requestDevice()).destroy();
    return true;
  } catch {
    return false;
  }
}

// Opens the model with the first provider that takes it, each in its own runtime, and tells which.
async function open(model, [provider, ...others]) {
  try {
    self.postMessage({ stage: "Loading the runtime" });
    ort = await import(`./runtime/ort.${provider}.min.mjs`);
    ort.env.wasm.wasmPaths = new URL("runtime/", import.meta.url).href;
    ort.env.wasm.numThreads = self.crossOriginIsolated ? navigator.hardwareConcurrency : 1;
    self.postMessage({ stage: "Preparing the network" });
    session = await ort.InferenceSession.create(model, { executionProviders: [provider] });
    return provider;
  } catch (error) {
    if (!others.length) throw error;
    return open(model, others);
  }
}

async function download(url, size) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: the server answers ${response.status}`);
  const content = new Uint8Array(size);
  let got = 0;
  for (const reader = response.body.getReader(); ; ) {
    const { done, value } = await reader.read();
    if (done) break;
    content.set(value, got);
    got += value.length;
    self.postMessage({ stage: "Loading the network", share: got / size });
  }
  return content;
}

async function match(left, right) {
  const scale = Math.min(1, settings.width / left.width, settings.height / left.height);
  const width = Math.round(left.width * scale), height = Math.round(left.height * scale);
  const feeds = { left: await input(left, width, height), right: await input(right, width, height) };
  const started = performance.now();
  const found = await session.run(feeds);
  const seconds = (performance.now() - started) / 1000;
  const disparity = crop(found.disparity.data, width, height).map((value) => value / scale);
  const confidence = found.confidence ? crop(found.confidence.data, width, height) : null;
  self.postMessage({ result: { width, height, scale, disparity, confidence, seconds } });
}

// RGB in 0..1, padded above and on the right with the border's pixels.
async function input(bitmap, width, height) {
  if (bitmap.width !== width || bitmap.height !== height) {
    const size = { resizeWidth: width, resizeHeight: height, resizeQuality: "high" };
    const resized = await createImageBitmap(bitmap, size);
    bitmap.close();
    bitmap = resized;
  }
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const { data } = context.getImageData(0, 0, width, height);
  const plane = settings.width * settings.height;
  const values = new Float32Array(3 * plane);
  for (let y = 0, to = 0; y < settings.height; y++) {
    const row = Math.max(0, y - (settings.height - height)) * width;
    for (let x = 0; x < settings.width; x++, to++) {
      const from = 4 * (row + Math.min(x, width - 1));
      for (let channel = 0; channel < 3; channel++) {
        values[channel * plane + to] = data[from + channel] / 255;
      }
    }
  }
  return new ort.Tensor("float32", values, [1, 3, settings.height, settings.width]);
}

function crop(map, width, height) {
  const cropped = new Float32Array(width * height);
  const above = settings.height - height;
  for (let y = 0; y < height; y++) {
    const start = (above + y) * settings.width;
    cropped.set(map.subarray(start, start + width), y * width);
  }
  return cropped;
}
