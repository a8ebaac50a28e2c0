// Tells disparity, depth and confidence of the pixel of the disparity picture that is pointed at.
// gradio runs this once for its HTML component, after `reading.js`: `element`, `props` and `watch`
// come from there.
const start = "Point at the picture, or tap it, to read the depth there.";
let pixels = null;

function load() {
  pixels = null;
  if (!props.value) return;
  const image = new Image();
  image.onload = () => {
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    pixels = context.getImageData(0, 0, image.width, image.height);
    element.querySelector("output").textContent = start;
  };
  image.src = props.value.levels;
}

function describe(pixel) {
  const { scale, confident, depth, doffs } = props.value;
  const [high, low, sure] = pixels.data.subarray(4 * (pixel.y * pixels.width + pixel.x));
  const geometry = depth === null ? null : { depth, doffs };
  const confidence = confident ? sure / 255 : null;
  return describePixel(pixel, (256 * high + low) / scale, confidence, geometry, 1 / scale);
}

function show(event) {
  const picture = event.target.closest?.("#disparity")?.querySelector("img");
  const pixel = pixels && picture && pixelUnder(event, picture, pixels.width, pixels.height);
  if (pixel) element.querySelector("output").textContent = describe(pixel);
}

document.addEventListener("pointermove", show);
document.addEventListener("pointerdown", show);
watch("value", load);
