// Stopping devices, and letting them go, as the hub's own requests: one for a channel or a whole session.
import type { Parcel } from "./parcel.js";
import { type Fields, Time, type Value, fieldsOf, int, list, text } from "./value.js";

/** How the devices of a channel stand by the hub's books, or how one of them does. */
export interface StopState {
  /** The number of the newest stop; 0 before the first. An unstop names it. */
  number: number;
  /** Whether a stop holds. */
  stopped: boolean;
  /** The peer that said it. */
  by?: string;
  /** That peer's user. */
  user?: string;
  /** Since when. */
  since?: Time;
  /** Why, in that peer's words. */
  reason?: string;
  /** The devices that are stopped, if it is not all of the channel. */
  only: string[];
  /** Devices that were let go by name while all others are stopped. */
  except?: string[];
}

/** @internal From the map that the hub tells of stops; where it tells none, nothing was ever stopped. */
export function stopStateOf(value: Value | undefined): StopState {
  const fields = fieldsOf(value);
  const state: StopState = { number: int(fields, "number") ?? 0, stopped: fields["stopped"] === true, only: list(fields, "only").map(String) };
  const except = list(fields, "except").map(String);
  if (except.length) state.except = except;
  for (const key of ["by", "user", "reason"] as const) {
    const word = text(fields, key);
    if (word !== undefined) state[key] = word;
  }
  if (fields["since"] instanceof Time) state.since = fields["since"];
  return state;
}

/** @internal The number that a stop has, or that an unstop names. */
export function stopSlot({ extra }: Parcel): number | undefined {
  const slot = extra instanceof Map ? extra.get("stop") : extra?.["stop"];
  return typeof slot === "number" && slot >= 0 ? slot : undefined;
}

/** Of a stop or an unstop. */
export interface StopOptions {
  /** Why, for anyone who finds the devices stopped. */
  reason?: string;
  /** For how many ms the hub waits for the devices' word, at most 10 000; 0 for not at all; 1000 unless said. */
  within?: number;
  /** Only these devices of a channel. */
  only?: string[];
}

/** What a device said: that it obeys (`stopped`, `unstopped`), nothing in time (`silent`), or that its connection is lost: it gets the stop when it comes back. */
export type DeviceWord = "stopped" | "unstopped" | "silent" | "lost";

/** A device, and what it said. */
export interface DeviceAnswer {
  peer: string;
  word: DeviceWord;
  /** How it knows that it rests; absent: it does not know yet, or says nothing of it. */
  rest?: "measured" | "not-measured";
  /** It obeys and moves still, or does not know that it does not. */
  moving?: true;
  /** It cannot tell its mechanism what to do. */
  reached?: false;
  /** An emergency stop at the device itself is pressed: an `unstop` does not let it go. */
  estop?: true;
}

/** One channel that was told. */
export interface ToldChannel {
  path: string;
  /** The number of the stop, or of the newest one that the unstop was to lift. */
  number: number;
  /** Whether a device is meant to be there: a token guards it, or one was there before. */
  guarded: boolean;
  /** Whether the hub knows of it after a restart. */
  kept: boolean;
  devices: DeviceAnswer[];
  /** Newer stops, which hold on: the unstop did not lift them. */
  newer: StopState[];
  /** Why the unstop was not handed out. */
  error?: string;
}

/** What came of a stop or an unstop. */
export interface StopReport {
  /** The channels that have devices or a guard, and those that had devices and are not there; 1024 at most. */
  channels: ToldChannel[];
  /** How many other channels were told. */
  others: number;
  /** Channels that this peer may see and not stop. */
  denied: string[];
}

/** @internal */
export function reportOf(fields: Fields): StopReport {
  const told = list(fields, "channels").map((value) => toldOf(fieldsOf(value)));
  return { channels: told, others: int(fields, "others") ?? 0, denied: list(fields, "denied").map(String) };
}

function toldOf(fields: Fields): ToldChannel {
  const maps = (key: string): Fields[] => list(fields, key).map(fieldsOf);
  const told: ToldChannel = {
    path: text(fields, "path") ?? "",
    number: int(fields, "number") ?? 0,
    guarded: fields["guard"] === true,
    kept: fields["kept"] === true,
    // As the hub says it.
    devices: maps("devices") as unknown as DeviceAnswer[],
    newer: maps("newer").map((newer) => {
      const device = text(newer, "device");
      return { ...stopStateOf(newer), stopped: true, only: device === undefined ? [] : [device] };
    }),
  };
  const error = text(fields, "error");
  return error === undefined ? told : { ...told, error };
}

/** Whether every device of a channel has obeyed, and none still moves; a guarded channel has one at least. */
export function isObeyed({ devices, guarded, newer, error }: ToldChannel): boolean {
  return devices.every(({ word, moving, reached }) => /stopped$/.test(word) && !moving && reached !== false) && !(guarded && !devices.length) && !newer.length && error === undefined;
}
