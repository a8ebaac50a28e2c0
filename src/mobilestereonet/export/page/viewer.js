// Photo and disparity under one slider, with a bar of depths, limits, a readout and distances:
// shared by `msnet web` and by the exported page. Needs `reading.js`.

const VIEWER = `
  <div id="pictures">
    <canvas id="picture"></canvas>
    <canvas id="disparity"></canvas>
    <svg id="marks" preserveAspectRatio="none"></svg>
  </div>
  <div id="scale">
    <input id="slider" type="range" min="0" max="100" value="50" aria-label="Photo or depth" />
    <p id="legend"><span>photo</span><span>depth</span></p>
    <canvas id="bar" width="256" height="1"></canvas>
    <p id="ticks"></p>
    <div id="limits">
      <label>Nearest: <output></output><input id="near" type="range" min="0" max="256" value="256" /></label>
      <label>Farthest: <output></output><input id="far" type="range" min="0" max="256" value="0" /></label>
      <label id="sure">At least <output></output><input type="range" min="0" max="100" value="0" /></label>
    </div>
    <output id="readout"></output>
  </div>`;
const HINT = "Point at the picture to read it; click two places to measure between them.";

// Fills an element.
//   colours: those of 256 levels of disparity, from far to near, as hexadecimal digits
// Gives two functions: `preview(photo)` shows a photo alone, and `show(result)` a result with
//   left: the photo, or anything else that a canvas draws, with its width and height
//   width, height, disparity, confidence: maps, row by row; the disparity in px of the photo, 0
//     where it is unknown; the confidence in 0..1, or null
//   geometry: null, or what `describePixel` and `distanceBetween` take
function makeViewer(root, colours) {
  root.innerHTML = VIEWER;
  const $ = (id) => root.querySelector(`#${id}`);
  const palette = Uint8Array.from(colours.match(/../g), (digits) => parseInt(digits, 16));
  let shown = null, largest = 1, places = [];

  const bar = $("bar").getContext("2d");
  const levels = new ImageData(256, 1);
  for (let i = 0; i < 256; i++) levels.data.set([...palette.subarray(3 * i, 3 * i + 3), 255], 4 * i);
  bar.putImageData(levels, 0, 0);

  function preview(photo) {
    shown = null;
    root.classList.add("waiting");
    place(photo);
  }

  function place(photo) {
    const canvas = $("picture");
    [canvas.width, canvas.height] = [photo.width, photo.height];
    canvas.getContext("2d").drawImage(photo, 0, 0);
    $("marks").setAttribute("viewBox", `0 0 ${photo.width} ${photo.height}`);
    places = [];
    mark();
  }

  function show(result) {
    place(result.left);
    shown = result;
    root.classList.remove("waiting");
    [$("disparity").width, $("disparity").height] = [result.width, result.height];
    const sorted = result.disparity.slice().sort();
    largest = Math.max(sorted[Math.floor(0.99 * (sorted.length - 1))], 1e-6);
    $("sure").hidden = result.confidence === null;
    $("readout").textContent = HINT;
    draw();
  }

  // What a disparity is on the bar: metres where the cameras are known, else px.
  function worth(disparity) {
    const { geometry } = shown;
    if (geometry === null) return `${disparity.toFixed(0)} px`;
    const shift = disparity + geometry.doffs;
    return shift > 1e-3 ? metres(geometry.depth / shift) : "far";
  }

  function draw() {
    if (shown === null) return;
    const [near, far] = ["near", "far"].map((id) => Number($(id).value) / 256);
    const sure = Number($("sure").querySelector("input").value) / 100;
    const pixels = new ImageData(shown.width, shown.height);
    const { disparity, confidence } = shown;
    for (let i = 0; i < disparity.length; i++) {
      const share = disparity[i] / largest;
      const out = share < far || (near < 1 && share > near) || confidence?.[i] < sure;
      const level = 3 * Math.min(255, Math.floor(256 * share));
      if (out || disparity[i] <= 0) pixels.data[4 * i + 3] = 190; // the photo, darkened
      else pixels.data.set([palette[level], palette[level + 1], palette[level + 2], 255], 4 * i);
    }
    $("disparity").getContext("2d").putImageData(pixels, 0, 0);
    const ends = [near < 1 ? worth(near * largest) : "any", far > 0 ? worth(far * largest) : "any"];
    ["near", "far"].forEach((id, i) => {
      $(id).previousElementSibling.textContent = ends[i];
    });
    $("sure").querySelector("output").textContent = `${Math.round(100 * sure)} % sure`;
    $("ticks").replaceChildren(
      ...[0, 0.25, 0.5, 0.75, 1].map((share) => {
        const tick = document.createElement("span");
        tick.textContent = worth(share * largest);
        return tick;
      }),
    );
  }

  function at(event) {
    if (shown === null) return null;
    const map = pixelUnder(event, $("picture"), shown.width, shown.height);
    const photo = pixelUnder(event, $("picture"), shown.left.width, shown.left.height);
    if (!map || !photo) return null;
    const index = map.y * shown.width + map.x;
    return { ...photo, disparity: shown.disparity[index], sure: shown.confidence && shown.confidence[index] };
  }

  function read(event) {
    const pixel = at(event);
    if (!pixel) return;
    const text = describePixel(pixel, pixel.disparity, pixel.sure, shown.geometry, 1 / 256);
    $("readout").textContent = text + measured();
  }

  function measured() {
    if (places.length < 2) return "";
    const between = distanceBetween(...places, shown.geometry);
    return `\n${between === null ? "distances need metres" : `between the marks ${between}`}`;
  }

  function mark() {
    const dots = places.map(({ x, y }) => `<circle cx="${x + 0.5}" cy="${y + 0.5}" r="${$("picture").width / 90}" />`);
    const ends = places.flatMap(({ x, y }) => [x + 0.5, y + 0.5]);
    const line = ends.length < 4 ? "" : `<line x1="${ends[0]}" y1="${ends[1]}" x2="${ends[2]}" y2="${ends[3]}" />`;
    $("marks").innerHTML = line + dots.join("");
  }

  $("slider").addEventListener("input", (event) => {
    $("pictures").style.setProperty("--cut", `${event.target.value}%`);
  });
  $("limits").addEventListener("input", draw);
  for (const kind of ["pointermove", "pointerdown"]) $("pictures").addEventListener(kind, read);
  $("pictures").addEventListener("click", (event) => {
    const pixel = at(event);
    if (!pixel) return;
    places = places.length < 2 ? [...places, pixel] : [pixel];
    mark();
    read(event);
  });
  return { preview, show };
}
