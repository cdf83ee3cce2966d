// The calls to the ground station. What it refuses comes back as a Refusal with the ground station's own words.

const ROOT = "/api/v1";

function reasonOf(body, status) {
  return typeof body?.detail === "string" ? body.detail : `the ground station answered with status ${status}`;
}

/** What the ground station did not do, and the status of its answer; 0 where none came. */
export class Refusal extends Error {
  constructor(why, status) {
    super(why);
    this.status = status;
  }
}

async function call(method, path, body) {
  const options = { method, credentials: "same-origin", headers: { Accept: "application/json" } };
  if (body !== undefined) {
    options.headers["Content-Type"] = "application/json";
    options.body = JSON.stringify(body);
  }
  let response;
  try {
    response = await fetch(ROOT + path, options);
  } catch {
    throw new Refusal("the ground station does not answer", 0);
  }
  const answer = await response.json().catch(() => null);
  if (!response.ok) throw new Refusal(reasonOf(answer, response.status), response.status);
  return answer;
}

export const get = (path) => call("GET", path);
export const post = (path, body) => call("POST", path, body);
export const remove = (path) => call("DELETE", path);

/** Gives a command; the answer is the event that it became. */
export const command = (body) => post("/commands", body);
