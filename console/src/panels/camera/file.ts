// A picture as a file.
import { clock } from "../../texts/format.js";
import type { CameraView } from "./view.svelte.js";

/** Saves the picture that is shown: as the camera has sent it, or else as it is shown. */
export async function saved(view: CameraView, canvas: HTMLCanvasElement | undefined): Promise<void> {
  const { frame, path } = view;
  const file = await view.file().catch(() => null);
  const drawn = file ? null : await new Promise<Blob | null>((resolve) => (canvas ? canvas.toBlob(resolve) : resolve(null)));
  const blob = file ? new Blob([file.bytes as Uint8Array<ArrayBuffer>], { type: file.type }) : drawn;
  if (!blob) return;
  const time = frame?.born ?? Date.now();
  const name = `${path.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, "")}-${new Date(time).toISOString().slice(0, 10)}-${clock(time).replace(/[:.]/g, "")}`;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `${name}.${blob.type === "image/png" ? "png" : blob.type === "image/jpeg" ? "jpg" : "img"}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
