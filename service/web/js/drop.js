// A place for files: drop, choose, or reach it with the keyboard (the file input itself is the control).
import { $ } from "./dom.js";
import { bytes } from "./words.js";

/** Wire a drop zone around a file input; `changed` gets the files. Returns a function that empties it. */
export function dropZone(zone, changed) {
  const input = $("input[type=file]", zone);
  const name = $(".drop-name", zone);
  const empty = name.textContent;
  let depth = 0;
  const show = () => {
    const files = [...input.files];
    const size = files.reduce((sum, file) => sum + file.size, 0);
    zone.classList.toggle("full", files.length > 0);
    name.textContent =
      files.length === 0 ? empty : files.length === 1 ? `${files[0].name} · ${bytes(size)}` : `${files.length} pictures · ${bytes(size)}`;
    changed(files);
  };
  const over = (step) => (event) => {
    event.preventDefault();
    depth += step;
    zone.classList.toggle("over", depth > 0);
  };
  input.addEventListener("change", show);
  zone.addEventListener("dragenter", over(1));
  zone.addEventListener("dragleave", over(-1));
  zone.addEventListener("dragover", (event) => event.preventDefault());
  zone.addEventListener("drop", (event) => {
    depth = 0;
    over(0)(event);
    const files = [...event.dataTransfer.files];
    const given = new DataTransfer();
    for (const file of input.multiple ? files : files.slice(0, 1)) given.items.add(file);
    if (given.files.length === 0) return;
    input.files = given.files;
    show();
  });
  return () => {
    input.value = "";
    show();
  };
}
