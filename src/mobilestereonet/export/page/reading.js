// What a disparity picture tells at a place: shared by `msnet web` and by the exported page.

// Column and row of a picture of that size under a pointer; null beside it.
function pixelUnder(event, picture, width, height) {
  const box = picture.getBoundingClientRect();
  const x = Math.floor(((event.clientX - box.left) / box.width) * width);
  const y = Math.floor(((event.clientY - box.top) / box.height) * height);
  return x < 0 || y < 0 || x >= width || y >= height ? null : { x, y };
}

// A length as people say it.
function metres(length) {
  return `${length < 10 ? length.toFixed(2) : length.toFixed(length < 100 ? 1 : 0)} m`;
}

// Depth in metres; null where it is unknown.
function depthOf(disparity, geometry, resolution) {
  const shift = disparity + geometry.doffs;
  return disparity > 0 && shift >= resolution ? geometry.depth / shift : null;
}

// Disparity in px, depth in metres and confidence of a pixel, in words.
//   geometry: focal length (px) x baseline (m) as `depth`, the difference of the principal points
//     (`doffs`, px), and whether the scale is `guessed`; null where they are unknown
//   resolution: smallest disparity plus doffs, in px, that has a depth
//   confidence: 0..1, null where there is none
function describePixel({ x, y }, disparity, confidence, geometry, resolution) {
  const parts = [`column ${x}, row ${y}`];
  parts.push(disparity > 0 ? `disparity ${disparity.toFixed(2)} px` : "disparity unknown");
  if (geometry !== null) {
    const depth = depthOf(disparity, geometry, resolution);
    const guessed = geometry.guessed ? " (scale guessed)" : "";
    parts.push(depth === null ? "depth unknown" : `depth ${depth.toFixed(3)} m${guessed}`);
  }
  if (confidence !== null) parts.push(`${Math.round(100 * confidence)} % sure`);
  return parts.join(" · ");
}

// Distance in space between two pixels with their disparities, in words; null without geometry.
//   geometry: also the focal length (`focal`) and the principal point (`cx`, `cy`), in px
function distanceBetween(first, second, geometry) {
  if (geometry === null) return null;
  const { focal, cx, cy, guessed } = geometry;
  const points = [first, second].map(({ x, y, disparity }) => {
    const z = depthOf(disparity, geometry, 1 / 256);
    return z === null ? null : [((x - cx) * z) / focal, ((y - cy) * z) / focal, z];
  });
  if (points.includes(null)) return "unknown";
  const [a, b] = points;
  const length = Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  return `${length.toFixed(3)} m${guessed ? " (scale guessed)" : ""}`;
}
