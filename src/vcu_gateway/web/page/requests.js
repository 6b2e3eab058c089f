// Requests to the server: JSON up, JSON down, and a sentence where it fails.

export class Refusal extends Error {
  constructor(status, value) {
    super(value?.sentence || `the server answered ${status}`);
    this.status = status;
    this.value = value;
  }
}

export async function request(method, path, { json, body, timeout = 10_000 } = {}) {
  const response = await fetch(path, {
    method,
    body: json === undefined ? body : JSON.stringify(json),
    signal: AbortSignal.timeout(timeout),
    cache: "no-store",
  }).catch((error) => {
    const late = error.name === "TimeoutError";
    throw new Refusal(0, { sentence: late ? "no answer in time" : "the page's server cannot be reached" });
  });
  const value = await response.json().catch(() => null);
  if (!response.ok) throw new Refusal(response.status, value);
  return value;
}

/** A sentence for whatever went wrong. */
export const sentence = (error) => (error instanceof Refusal ? error.message : `a mistake in this page: ${error}`);
