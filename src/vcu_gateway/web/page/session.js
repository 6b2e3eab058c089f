// Who looks: signing in and out, and what the role may.

import { byId, setHidden, setText } from "/dom.js";
import { model, setClock } from "/model.js";
import { request, sentence } from "/requests.js";

/** Ask who this browser is; true where it may look. */
export async function checkSession() {
  const sent = performance.now();
  const session = await request("GET", "/api/session", { timeout: 3000 });
  setClock(session.clock, sent, performance.now());
  model.rights = new Set(session.rights);
  const who = session.has_users ? session.user && `${session.user} · ${session.role}` : session.role;
  setText(byId("who"), who || "");
  setHidden(byId("sign-out"), !(session.has_users && session.user));
  const dialog = byId("sign-in");
  if (!session.signed_in && !dialog.open) {
    const ended = Boolean(session.user);
    setText(byId("sign-in-why"), ended ? "The session has ended. The emergency stop still works." : "");
    ask(dialog);
  }
  if (session.signed_in && dialog.open) dialog.close();
  return session.signed_in;
}

function ask(dialog) {
  // Not modal: the emergency stop stays in reach.
  dialog.show();
  byId("sign-in-name").focus({ preventScroll: true });
}

export function startSession(onChange) {
  byId("sign-in").addEventListener("cancel", (event) => event.preventDefault());
  byId("sign-in-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const name = byId("sign-in-name").value;
    const password = byId("sign-in-password");
    setText(byId("sign-in-problem"), "");
    try {
      await request("POST", "/api/session", { json: { name, password: password.value } });
      password.value = "";
      if (await checkSession()) onChange();
    } catch (error) {
      setText(byId("sign-in-problem"), sentence(error));
      password.select();
    }
  });
  byId("sign-out").addEventListener("click", async () => {
    await request("DELETE", "/api/session").catch(() => null);
    location.reload();
  });
}
