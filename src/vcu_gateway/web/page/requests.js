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
  });
  const value = await response.json().catch(() => null);
  if (!response.ok) throw new Refusal(response.status, value);
  return value;
}

/** A sentence for whatever went wrong. */
export function sentence(error) {
  if (error instanceof Refusal) return error.message;
  if (error.name === "TimeoutError") return "no answer in time";
  return "the page's server cannot be reached";
}
