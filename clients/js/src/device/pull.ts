// Devices that ask for their commands: behind a bad link nothing is carried out late.
import type { Parcel } from "../index.js";
import { Refusal } from "./states.js";

/** How old a command is, µs, and the error of that; without an error it is older by an unknown time. */
export interface DeviceAge {
  micros: number;
  error?: number;
}

/** The message by which a device asks for its next command. */
export const NEXT = "next";

/**
 * What a device has asked for, and which command it takes: the answer to its newest request, once, and only while it is surely good. A
 * request that was asked again is void, so that a command that comes late is never carried out, and who feeds the device may send it
 * anew.
 */
export class Pull {
  /** The id of the newest request, while it is not answered. */
  #asked: number | undefined;
  /** When it is asked again, µs. */
  due = 0;

  constructor(
    /** For how many µs a request waits. */
    readonly wait: number,
  ) {}

  /** Notes that it asks now, by a message of this id. */
  ask(id: number, now: number): void {
    [this.#asked, this.due] = [id, now + this.wait];
  }

  /** Has it ask as soon as it has nothing to do, as its request was answered or there is another owner to ask. */
  renew(now: number): void {
    [this.#asked, this.due] = [undefined, now];
  }

  /** Throws why a command may not be taken; the safe state that the hub orders may always. */
  check({ sender, expires: life, reference }: Parcel, age: DeviceAge | undefined): void {
    if (sender === "hub") return;
    if (life === undefined) throw badSlot("expires", "this device asks for its commands, so each requires the slot `expires` (ms)");
    if (reference === undefined) {
      throw badSlot("reference", "this device asks for its commands: answer its message `next`, with its id in the slot `reference`");
    }
    if (age?.error === undefined) throw expired("how old the command is is not known, as a clock is not measured yet; the device does not carry it out, and asks again");
    const oldest = Math.max(0, age.micros) + age.error;
    if (oldest >= life * 1000) {
      throw expired(`the command may be ${Math.ceil(oldest / 1000)} ms old, and was good for ${life} ms; the device does not carry it out, and asks again`);
    }
    if (reference !== this.#asked) throw expired("the command answers an earlier request, which is void since the device has asked again or was answered");
  }
}

function badSlot(slot: string, text: string): Refusal {
  return new Refusal({ name: "bad-slot", code: 220, text, slot });
}

function expired(text: string): Refusal {
  return new Refusal({ name: "expired", code: 207, text });
}
