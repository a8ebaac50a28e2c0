// Tells disparity, depth and confidence of the pixel of the disparity picture that is pointed at.
// gradio runs this once for its HTML component: `element`, `props` and `watch` come from there.
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

function describe(x, y) {
  const { scale, confident, depth, doffs } = props.value;
  const [high, low, sure] = pixels.data.subarray(4 * (y * pixels.width + x));
  const disparity = (256 * high + low) / scale;
  const parts = [`column ${x}, row ${y}`];
  parts.push(disparity > 0 ? `disparity ${disparity.toFixed(2)} px` : "disparity unknown");
  if (depth !== null) {
    const known = disparity > 0 && disparity + doffs >= 1 / scale;
    parts.push(known ? `depth ${(depth / (disparity + doffs)).toFixed(3)} m` : "depth unknown");
  }
  if (confident) parts.push(`${Math.round((100 * sure) / 255)} % sure`);
  return parts.join(" · ");
}

function show(event) {
  const picture = event.target.closest?.("#disparity")?.querySelector("img");
  if (!pixels || !picture) return;
  const box = picture.getBoundingClientRect();
  const x = Math.floor(((event.clientX - box.left) / box.width) * pixels.width);
  const y = Math.floor(((event.clientY - box.top) / box.height) * pixels.height);
  if (x < 0 || y < 0 || x >= pixels.width || y >= pixels.height) return;
  element.querySelector("output").textContent = describe(x, y);
}

document.addEventListener("pointermove", show);
document.addEventListener("pointerdown", show);
watch("value", load);
