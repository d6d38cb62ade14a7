// Which installed program a device is, so that the same one, started again, takes its own place.
import { Time } from "./value.js";

export interface Installation {
  installation: string;
  begun: Time;
}

/** One that is started now; without a name it is another one after each start. */
export function installed(name: string | undefined): Installation {
  const unknown = (): string => Array.from(crypto.getRandomValues(new Uint8Array(8)), (byte) => byte.toString(16).padStart(2, "0")).join("");
  return { installation: name ?? unknown(), begun: Time.now() };
}
