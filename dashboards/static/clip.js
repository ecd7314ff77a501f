// A reference clip from the reader's own disk: a replay.bin as it is, a DeepMimic text by way of the service.
export const LARGEST_CLIP = 5_000_000;

export async function clipReplay(file, bar) {
  const head = new Uint8Array(await file.slice(4, 5).arrayBuffer());
  // A replay begins with a length; its JSON with a brace after it. A clip's text has neither there.
  if (head[0] === 0x7b) return file.arrayBuffer();
  const answer = await fetch("/api/v1/reference", {
    method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ text: await file.text(), bar: Math.max(0, Math.min(4, bar)) }),
  });
  if (!answer.ok) {
    const said = await answer.json().catch(() => null);
    throw new Error(said?.error?.message ?? `the service answered with status ${answer.status}`);
  }
  return answer.arrayBuffer();
}
