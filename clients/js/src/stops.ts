// Stopping devices, and letting them go, as the hub's own requests: one for a channel or a whole session.
import { type StopState, stopStateOf } from "./latch.js";
import { type Fields, fieldsOf, int, list, text } from "./value.js";

/** Of a stop or an unstop. */
export interface StopOptions {
  /** Why, for whoever finds the devices stopped. */
  reason?: string;
  /** For how many ms the hub waits for the devices' word, at most 10 000; 0 for not at all; 1000 unless said. */
  within?: number;
  /** Only these devices of a channel. */
  only?: string[];
}

/** What a device said: that it obeys (`stopped`, `unstopped`), nothing in time (`silent`), or that its connection is lost: it finds the stop when it comes back. */
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
