// Asks for the token when the service requires it. The page stays as it is behind the dialog.

import { login, onUnauthorized } from "./api.js";
import { byId, h, setText } from "./dom.js";

/** Where the token is, unless the page says something else. */
const WHERE = "The service requires a token. Its configuration (http.token_file) names the file that contains it.";

/** `where` tells the user where the token is. */
export function installLogin(where = WHERE) {
  document.body.append(createDialog(where));
  let pending = null;
  onUnauthorized(() => {
    pending ??= askForToken().finally(() => {
      pending = null;
    });
    return pending;
  });
}

function createDialog(where) {
  const form = h("form", { id: "login-form" },
    h("h2", { id: "login-title" }, "Log in"),
    h("p", { id: "login-text" }, where),
    h("label", { class: "field" }, "Token",
      h("input", { id: "token", name: "token", type: "password", autocomplete: "current-password", required: true })),
    h("p", { id: "login-answer", class: "answer", role: "alert" }),
    h("button", {}, "Log in"));
  return h("dialog", { id: "login", "aria-labelledby": "login-title" }, form);
}

/** Resolves when the service has accepted a token. */
function askForToken() {
  const [dialog, form, token] = ["login", "login-form", "token"].map(byId);
  setText(byId("login-answer"), "");
  dialog.showModal();
  return new Promise((resolve) => {
    // Without a token the page shows nothing: the dialog stays open.
    const keepOpen = (event) => event.preventDefault();
    const submit = async (event) => {
      event.preventDefault();
      setText(byId("login-answer"), "Logging in …");
      try {
        await login(token.value);
      } catch (error) {
        return setText(byId("login-answer"), error.kind === "unauthorized" ? "Wrong token." : error.message);
      }
      form.removeEventListener("submit", submit);
      dialog.removeEventListener("cancel", keepOpen);
      token.value = "";
      dialog.close();
      resolve();
    };
    form.addEventListener("submit", submit);
    dialog.addEventListener("cancel", keepOpen);
  });
}
