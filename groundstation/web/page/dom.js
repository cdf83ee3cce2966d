// Elements are made here and nowhere else, and text goes into them as text: names and reasons come from outside and may
// hold anything.

/** An element with properties, attributes and children; strings become text nodes, null and false are left out. */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "class") element.className = value;
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && typeof value !== "string") element[name] = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** Sets an element's text if it is another one than before: what does not change is not laid out again. */
export function setText(element, text) {
  const wanted = String(text);
  if (element.textContent !== wanted) element.textContent = wanted;
}

export function setAttribute(element, name, value) {
  if (value === null || value === false) {
    if (element.hasAttribute(name)) element.removeAttribute(name);
  } else if (element.getAttribute(name) !== String(value)) {
    element.setAttribute(name, String(value));
  }
}

/** Puts an element behind another of its list, at its beginning for null; one that stands there is not touched. */
export function inOrder(list, element, before) {
  const place = before ? before.nextSibling : list.firstChild;
  if (place !== element) list.insertBefore(element, place);
}

export function byId(id) {
  return document.getElementById(id);
}
