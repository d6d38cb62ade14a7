// What a client can be a device by: `mom-client/device` makes it.
import type { Events } from "../events.js";
import type { Fields } from "../value.js";
import type { Channel } from "./channel.js";

/** A device that {@link Client.obey} takes to a channel, such as `device` of `mom-client/device` gives; `Obeying` is what it is there. */
export interface Obeys<Obeying> {
  /** What it can do, as a plain map. */
  card(): Fields;
  /** Throws where it cannot be taken to a channel now. */
  check(): void;
  /** Begins to obey what is heard in the channel; {@link Client.obey} calls it. */
  start(channel: Channel, events: Events): Obeying;
}
