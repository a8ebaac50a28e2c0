// Tells how long a match has taken, and of how long: `element`, `props` and `watch` are gradio's.
let started = 0;

function tell() {
  const { value } = props;
  const bar = element.querySelector("i"), text = element.querySelector("output");
  element.classList.toggle("busy", Boolean(value));
  if (!value) return void (started = 0);
  started ||= performance.now();
  const seconds = (performance.now() - started) / 1000;
  const { label, expected } = value;
  const about = expected ? ` of about ${Math.max(1, expected).toFixed(0)} s` : " s";
  text.textContent = `${label}: ${seconds.toFixed(0)}${about}`;
  bar.style.width = `${expected ? Math.min(99, (100 * seconds) / Math.max(1, expected)) : 0}%`;
}

setInterval(tell, 200);
watch("value", tell);
tell();
