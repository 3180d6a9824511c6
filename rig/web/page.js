"use strict";
const $ = (id) => document.getElementById(id);
let known = 0;
let keysShown = "";

function text(element, words, kind) {
  element.hidden = !words;
  element.textContent = words || "";
  if (kind !== undefined) element.className = kind;
}

function rows(values) {
  $("values").replaceChildren(...values.map(([name, primary, secondary]) => {
    const row = document.createElement("tr");
    const head = document.createElement("th");
    head.textContent = name;
    row.append(head);
    for (const value of [primary, secondary]) {
      const cell = document.createElement("td");
      cell.textContent = value;
      row.append(cell);
    }
    return row;
  }));
}

function lines(list, items) {
  list.replaceChildren(...items.map((words) => {
    const item = document.createElement("li");
    item.textContent = words;
    return item;
  }));
}

function press(key) {
  return fetch("/key", { method: "POST", body: key, headers: { "Content-Type": "text/plain" } });
}

function keys(list) {
  const wanted = JSON.stringify(list);
  if (wanted === keysShown) return;
  keysShown = wanted;
  $("keys").replaceChildren(...list.map(([key, label]) => {
    const button = document.createElement("button");
    button.textContent = label;
    button.dataset.key = key;
    button.addEventListener("click", () => press(key));
    return button;
  }));
}

function trace(values) {
  $("history").toggleAttribute("hidden", values.length < 2);
  const reach = Math.max(0.1, ...values.map(Math.abs));
  $("trace").setAttribute("points", values.map((value, i) =>
    `${(i * 600) / Math.max(1, values.length - 1)},${40 - (value / reach) * 36}`).join(" "));
}

function draw(state) {
  known = state.n;
  text($("title"), [state.banner, state.title || "rig"].filter(Boolean).join(" · "));
  text($("status"), state.ended ? `${state.status || ""} · ended` : state.status);
  text($("big"), state.big, state.level);
  text($("hint"), state.hint, state.level);
  rows(state.values || []);
  lines($("notes"), state.notes || []);
  keys(state.ended ? [] : state.keys || []);
  trace(state.history || []);
  for (const side of ["primary", "secondary"]) $(side).src = `/${side}.jpg?n=${state.n}`;
  document.body.dataset.n = state.n;
}

async function watch() {
  let ended = false;
  while (!ended) {
    try {
      const answer = await fetch(`/state?after=${known}`);
      if (!answer.ok) throw new Error(answer.statusText);
      const state = await answer.json();
      if (state.n > known) draw(state);
      ended = Boolean(state.ended);
    } catch {
      text($("status"), "the run has ended, or cannot be reached");
      return;
    }
    await new Promise((resume) => setTimeout(resume, 100));
  }
}

addEventListener("keydown", (event) => {
  const means = [...$("keys").children].some((button) => button.dataset.key === event.key);
  if (means && !event.repeat) press(event.key);
});
watch();
