// Whether this page reports its errors to the hub, where operators read them (M56): its user decides, and it does not unless told to.
import type { Failure } from "../worker/protocol.js";
import type { Hub } from "./hub.svelte.js";
import { remember, remembered } from "./remember.js";

const KEY = "mom-reports";

export class Reporting {
  on = $state(remembered(KEY) === true);

  constructor(readonly hub: Hub) {}

  decide(on: boolean): void {
    this.on = on;
    remember(KEY, on);
  }

  /** Reports each error that is noted, as long as its user wants that, until the function that it gives is called. */
  start(): () => void {
    return this.hub.onError((text, failure) => this.on && this.#report(text, failure));
  }

  #report(text: string, failure: Failure | undefined): void {
    const { address, login } = this.hub;
    const said = login?.password ? text.replaceAll(login.password, "…") : text;
    void this.hub.call("report", address, { text: said, program: "mom-console", ...(failure ? { code: failure.code } : {}) }).catch(() => undefined);
  }
}
