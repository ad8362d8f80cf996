// Comforts of the guide: search, buttons that copy code, sections of the page. Every page can be read without them.
const wide = matchMedia("(min-width: 78rem)");
const sections = document.querySelector("#sections details");
const showSections = () => { if (sections) sections.open = wide.matches; };
wide.addEventListener("change", showSections);
showSections();

for (const block of document.querySelectorAll("main pre:not(:has(> .language-text))")) {
  const frame = document.createElement("div"), button = document.createElement("button");
  frame.className = "copied";
  button.type = "button";
  button.textContent = "Copy";
  block.replaceWith(frame);
  frame.append(block, button);
  button.addEventListener("click", async () => {
    const commands = [...block.textContent.matchAll(/^\$ (.*)$/gm)].map((line) => line[1]);
    await navigator.clipboard.writeText(commands.length ? commands.join("\n") : block.textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}

const form = document.querySelector("[role=search]"), [field, found, status] = form.children;
const MOST = 12, AROUND = 60;
let index, asked;
form.hidden = false;
globalThis.guideIndex = (entries) => {
  index = entries.map((entry) => {
    const [, , title, heading, text] = entry.map((part) => part.toLowerCase());
    return { entry, head: `${title} ${heading}`, all: text };
  });
  search();
};

function loadIndex() {
  if (asked) return;
  asked = document.createElement("script");
  asked.src = "search.js";
  document.head.append(asked);
}

function search() {
  const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
  found.replaceChildren();
  status.textContent = "";
  if (!words.length || !index) return;
  const score = ({ head, all }) => words.reduce(
    (sum, word) => sum && (head.includes(word) ? sum + 10 : all.includes(word) ? sum + 1 : 0), 1);
  const hits = index.map((item) => [score(item), item]).filter(([points]) => points).sort((a, b) => b[0] - a[0]);
  for (const [, { entry: [page, anchor, title, heading, text], all }] of hits.slice(0, MOST)) {
    const [item, link, line] = ["li", "a", "span"].map((tag) => document.createElement(tag));
    const at = Math.max(0, all.indexOf(words.find((word) => all.includes(word)) ?? "") - AROUND);
    link.href = `${page}.html#${anchor}`;
    link.textContent = heading === title ? title : `${title}: ${heading}`;
    line.textContent = text.slice(at, at + 2 * AROUND);
    link.append(line);
    item.append(link);
    found.append(item);
  }
  status.textContent = hits.length ? `${hits.length} sections` : "Nothing found";
}

field.addEventListener("focus", loadIndex);
field.addEventListener("input", search);
form.addEventListener("submit", (event) => {
  event.preventDefault();
  found.querySelector("a")?.click();
});
form.addEventListener("click", (event) => {  // a section of this page is reached without loading it again
  if (event.target.closest("a")) { field.value = ""; setTimeout(search); }
});
addEventListener("keydown", (event) => {
  const links = [...found.querySelectorAll("a")], at = links.indexOf(document.activeElement);
  if (event.key === "/" && !/^(INPUT|TEXTAREA)$/.test(document.activeElement.tagName)) {
    event.preventDefault();
    field.focus();
  } else if (event.key === "Escape" && form.contains(document.activeElement)) {
    field.value = "";
    search();
    field.focus();
  } else if (links.length && form.contains(document.activeElement) && /^Arrow(Up|Down)$/.test(event.key)) {
    event.preventDefault();
    ([field, ...links][at + 1 + (event.key === "ArrowDown" ? 1 : -1)] ?? field).focus();
  }
});
