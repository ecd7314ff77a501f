// The file replay.bin: a length, a JSON header, float32 arrays that the header names (workers/replay.py).

const NEEDED = { position: 3, orientation: 3, com: 2, ground_force: 1 };

export class BadReplay extends Error {}

export function read(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8) throw new BadReplay("The file is too short to be a replay.");
  const length = view.getUint32(0, true);
  let header;
  try {
    header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  } catch {
    throw new BadReplay("The file is not a replay.");
  }
  if (header.format !== "halma-replay" || header.version !== 1) {
    throw new BadReplay(`Expected a halma-replay of version 1, found ${header.format} ${header.version}.`);
  }
  const arrays = {};
  const shapes = {};
  for (const { name, shape, offset } of header.arrays) {
    const count = shape.reduce((product, size) => product * size, 1);
    if (4 + length + offset + 4 * count > buffer.byteLength) throw new BadReplay("The replay is cut short.");
    arrays[name] = new Float32Array(buffer, 4 + length + offset, count);
    shapes[name] = shape;
  }
  for (const [name, axes] of Object.entries(NEEDED)) {
    if (shapes[name]?.length !== axes) throw new BadReplay(`The replay has no ${name}.`);
  }
  return { header, arrays, shapes, frames: shapes.com[0], bodies: shapes.position[1], step: header.frame_seconds };
}

// When the centre of mass passes the bar's plane x = 0, in seconds; null where it never does.
export function overTheBar({ arrays, frames, step }) {
  for (let frame = 1; frame < frames; frame++) {
    const [before, now] = [arrays.com[3 * (frame - 1)], arrays.com[3 * frame]];
    if (before < 0 && now >= 0) return (frame - 1 + before / (before - now)) * step;
  }
  return null;
}

export async function fetchReplay(address) {
  const answer = await fetch(address);
  if (answer.status === 404) throw new BadReplay("This trial left no replay.");
  if (!answer.ok) throw new BadReplay(`The replay could not be fetched (status ${answer.status}).`);
  return read(await answer.arrayBuffer());
}
