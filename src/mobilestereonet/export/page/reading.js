// What a disparity picture tells at a place: shared by `msnet web` and by the exported page.

// Column and row of a picture of that size under a pointer; null beside it.
function pixelUnder(event, picture, width, height) {
  const box = picture.getBoundingClientRect();
  const x = Math.floor(((event.clientX - box.left) / box.width) * width);
  const y = Math.floor(((event.clientY - box.top) / box.height) * height);
  return x < 0 || y < 0 || x >= width || y >= height ? null : { x, y };
}

// Disparity in px, depth in metres and confidence of a pixel, in words.
//   geometry: focal length (px) x baseline (m) and the difference of the principal points (px);
//     null where they are unknown
//   resolution: smallest disparity plus doffs, in px, that has a depth
//   confidence: 0..1, null where there is none
function describePixel({ x, y }, disparity, confidence, geometry, resolution) {
  const parts = [`column ${x}, row ${y}`];
  parts.push(disparity > 0 ? `disparity ${disparity.toFixed(2)} px` : "disparity unknown");
  if (geometry !== null) {
    const shift = disparity + geometry.doffs;
    const known = disparity > 0 && shift >= resolution;
    parts.push(known ? `depth ${(geometry.depth / shift).toFixed(3)} m` : "depth unknown");
  }
  if (confidence !== null) parts.push(`${Math.round(100 * confidence)} % sure`);
  return parts.join(" · ");
}
