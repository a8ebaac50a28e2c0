// Shows an answer of the server with `viewer.js`. gradio runs this once for its HTML component,
// after `reading.js` and `viewer.js`: `element`, `props` and `watch` come from there.
const root = document.createElement("div");
root.id = "viewer";
const viewer = makeViewer(root, COLOURS);

async function load() {
  if (!root.isConnected) element.append(root); // the template is rendered again with each value
  const { value } = props;
  if (!value) return;
  const left = await picture(value.left);
  if (props.value !== value) return; // a newer one has come meanwhile
  if (!value.levels) return viewer.preview(left);
  const maps = await picture(value.levels);
  if (props.value !== value) return;
  viewer.show({ left, ...unpack(maps, value), geometry: value.geometry });
}

async function picture(url) {
  const image = new Image();
  image.src = url;
  await image.decode();
  return image;
}

function unpack(maps, { scale, confident }) {
  const { width, height } = maps;
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(maps, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const disparity = new Float32Array(width * height);
  const confidence = confident ? new Float32Array(width * height) : null;
  for (let i = 0; i < disparity.length; i++) {
    disparity[i] = (256 * data[4 * i] + data[4 * i + 1]) / scale;
    if (confident) confidence[i] = data[4 * i + 2] / 255;
  }
  return { width, height, disparity, confidence };
}

watch("value", load);
load();
