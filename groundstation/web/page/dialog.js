// The one dialog of the page: every action is confirmed here, and what the ground station refuses is said here.

import { post } from "./api.js";
import { byId, el, setText } from "./dom.js";

let opener = null;

/** Asks for confirmation.
 *
 * `ask` is {title, text, fields, confirm, danger, act}: `fields` are elements of a form, `act` is called when it is
 * confirmed and answers a promise. The dialog stays open with the reason if that is refused, else it closes. With
 * `must` there is no way out but that. */
export function confirmed(ask) {
  const dialog = byId("dialog");
  if (dialog.open) dialog.close();
  opener = document.activeElement;
  const error = el("p", { class: "refusal", role: "alert", hidden: true });
  const yes = el("button", { type: "submit", class: ask.danger ? "danger" : "primary" }, ask.confirm);
  const no = ask.must ? null : el("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
  const form = el(
    "form",
    { novalidate: true },
    el("h2", { id: "dialog-title" }, ask.title),
    (Array.isArray(ask.text) ? ask.text : [ask.text]).filter(Boolean).map((line) => el("p", {}, line)),
    ask.fields ?? [],
    error,
    el("div", { class: "row end" }, [no, yes]),
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    yes.disabled = true;
    error.hidden = true;
    try {
      await ask.act(new FormData(form));
      dialog.close();
    } catch (problem) {
      setText(error, `Refused: ${problem.message}`);
      error.hidden = false;
    } finally {
      yes.disabled = false;
    }
  });
  dialog.replaceChildren(form);
  dialog.oncancel = (event) => ask.must && event.preventDefault();
  dialog.showModal();
  (form.querySelector("input:not([type=radio]), select") ?? yes).focus();
}

/** Asks for a token until it is right; answers who that is. */
export function logIn() {
  return new Promise((resolve) => {
    confirmed({
      title: "Log in",
      text: "This ground station lets in who has a token (groundstation token).",
      fields: [field("token", "Token", { type: "password", required: true })],
      confirm: "Log in",
      must: true,
      act: async (form) => resolve(await post("/session", { token: form.get("token") })),
    });
  });
}

/** The focus goes back to where it was. */
export function prepareDialog() {
  const dialog = byId("dialog");
  dialog.addEventListener("close", () => {
    dialog.replaceChildren();
    if (opener?.isConnected) opener.focus({ preventScroll: true });
  });
}

/** A field of a form with its label and its unit or hint. */
export function field(name, label, properties = {}, hint = "") {
  const id = `field-${name}`;
  const describe = hint ? { "aria-describedby": `${id}-hint` } : {};
  return el(
    "div",
    { class: "field" },
    el("label", { for: id }, label),
    el("input", { id, name, autocomplete: "off", ...describe, ...properties }),
    hint ? el("small", { id: `${id}-hint` }, hint) : null,
  );
}

/** A choice among [value, words]. */
export function choice(name, label, options, value) {
  const id = `field-${name}`;
  const list = options.map(([key, text]) => el("option", { value: key, selected: key === value }, text));
  return el("div", { class: "field" }, el("label", { for: id }, label), el("select", { id, name }, list));
}
