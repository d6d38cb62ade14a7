// The emergency stop at the device itself: what its button says, and what the hub does not know of it yet.
import type { DeviceEvent } from "./server.js";

/**
 * Whether it is pressed, and whether the hub owes a number for that. Each press and each reset is a stop of its own, also of a device that
 * is stopped already, so that an `unstop` said before it lifts nothing: until the hub has given the device's own stop a number, no
 * `unstop` lets it go.
 */
export class Estop {
  /** What the device has said last; undefined: it knows of no such button. */
  known: boolean | undefined;
  /** Why nothing lets the device go: it has stopped itself, and the hub has not given that a number. */
  owed: string | undefined;
  /** The id of the newest message that says so. */
  #said: number | undefined;
  #linked = true;

  get isPressed(): boolean {
    return this.known === true;
  }

  /** Takes in what the device says of its button; why it has to stop, if that is another thing than before. */
  look(known: boolean | undefined): string | undefined {
    const wasPressed = this.isPressed;
    this.known = known;
    if (wasPressed === this.isPressed) return undefined;
    this.#said = undefined;
    return (this.owed = `its emergency stop was ${this.isPressed ? "pressed" : "reset"}`);
  }

  /** Takes in an event of the device's channel, where it is called so. */
  hear(event: DeviceEvent, name: string | undefined): void {
    if (event.type === "link-down") this.#linked = false;
    else if (event.type === "rejoined" || event.type === "link-resumed") this.#linked = true;
    else if (event.type === "message" && event.name === "stop" && event.sender === name) {
      // Its own stop comes back with a number; one that was said for an earlier press says nothing of this one.
      const { id } = event.parcel;
      if (this.#said !== undefined && id !== undefined && id >= this.#said) this.owed = undefined;
    }
  }

  /** Why it is to be said now that it has stopped itself, if that is so: it is said again when a lost link is back. */
  toSay(): string | undefined {
    return this.#linked ? this.owed : undefined;
  }

  /** It was said by a message of this id. */
  said(id: number): void {
    this.#said = id;
  }
}
