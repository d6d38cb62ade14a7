// Errors of devices, with the names, numbers and keys that all devices have (docs/PROTOCOL.md, "Errors of devices").
import type { Fields, Value } from "../value.js";
import { sayable, sayableOf, textOf } from "./sayable.js";

/** The number of each error's word. */
export const DEVICE_CODES = {
  /** The script cannot be read. */
  syntax: 5001,
  /** A place lies outside of where the device can be. */
  "workspace-boundary": 5002,
  /** The link to the mechanism failed, so that nothing is known of what was under way. */
  link: 5003,
  singularity: 5004,
  "joint-limit": 5005,
  "torque-overload": 5006,
  /** The command was ended before its end, or never begun, because the device was halted. */
  halted: 5101,
  stopped: 5102,
  "queue-full": 5103,
  "duplicate-id": 5104,
  /** The device still moves as its old owner had it move. */
  "changing-hands": 5105,
  busy: 5106,
  /** The command is older than it may be when it begins. */
  "too-old": 5107,
  /** A relative command does not name the state that it is based on. */
  "no-state": 5108,
  "zone-not-owned": 5109,
  obstacle: 5110,
  battery: 5111,
  /** An emergency stop at the device itself is pressed. */
  estop: 5112,
} as const;

/** The word of a device's error. */
export type DeviceErrorName = keyof typeof DEVICE_CODES;

/** What an error says beside its name and its text. */
export interface ErrorDetails {
  /** The same command may be taken a little later, although nothing about it changes. */
  retry?: boolean;
  /** The number of the statement concerned, 1 for the first. */
  statement?: number;
  /** The byte of the script at which the mistake begins, from 0. */
  position?: number;
  /** Its line and its column, from 1. */
  line?: number;
  column?: number;
  /** The known word that was probably meant. */
  nearest?: string;
  /** ms since the device had come to rest. */
  late?: number;
  /** The nearest position that the device can reach. */
  reachable?: Value;
}

/** Why a device does not carry a command out, in plain words. A verb and a plan throw it; `status` tells it to all. */
export class DeviceError extends Error {
  override readonly name = "DeviceError";
  /** Plain words, with the statement's number in front where there is one; what no string may hold is replaced. */
  readonly text: string;
  readonly details: Readonly<ErrorDetails>;

  constructor(
    readonly word: DeviceErrorName,
    text: string,
    details: ErrorDetails = {},
  ) {
    const told = sayable(text);
    super(told);
    this.text = told;
    this.details = word === "queue-full" || word === "busy" ? { retry: true, ...details } : details;
  }

  /** The number of the word. */
  get code(): number {
    return DEVICE_CODES[this.word];
  }

  /** The same error, said of a statement (1 for the first). */
  atStatement(statement: number): DeviceError {
    if (this.details.statement !== undefined) return this;
    return new DeviceError(this.word, `statement ${statement}: ${this.text}`, { ...this.details, statement });
  }

  /** As a map: `name`, `code`, `text`, and what else applies and can be said. */
  content(): Fields {
    const { retry, statement, position, line, column, nearest, late, reachable } = this.details;
    const more = { retry: retry || undefined, statement, position, line, column, nearest, late, reachable };
    return defined({ name: sayable(this.word), code: this.code, text: this.text, ...sayableOf(more) });
  }
}

/** The error of a device for whatever was thrown: an exception that is none says that the mechanism failed. */
export function deviceErrorOf(what: string, thrown: unknown): DeviceError {
  if (thrown instanceof DeviceError) return thrown;
  return new DeviceError("link", `${what} failed: ${textOf(thrown)}`);
}

/** A mistake in a script, at this byte. */
export function syntax(position: number, text: string, details: ErrorDetails = {}): DeviceError {
  return new DeviceError("syntax", text, { ...details, position });
}

/** Without members that are undefined. */
export function defined(fields: Fields): Fields {
  return Object.fromEntries(Object.entries(fields).filter(([, value]) => value !== undefined));
}
