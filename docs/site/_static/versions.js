// SPDX-License-Identifier: Apache-2.0
// Fills the list of versions from versions.json beside the folders of the versions; from a file it stays as it is.
document.addEventListener("DOMContentLoaded", async () => {
  const box = document.querySelector(".versions");
  if (!box || location.protocol === "file:") return;
  const root = document.documentElement.dataset.content_root || "./";
  const response = await fetch(root + "../versions.json").catch(() => null);
  if (!response || !response.ok) return;
  const select = box.querySelector("select"), own = box.dataset.version;
  select.replaceChildren(...(await response.json()).map(name => new Option(name, name, name === own, name === own)));
  select.disabled = false;
  select.addEventListener("change", () => { location.href = `${root}../${select.value}/index.html`; });
});
