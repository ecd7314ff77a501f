// How a body passes the bar, in plain words: which way it looks and how its trunk lies.
//
// The world's x leads through the bar and y up; a body's x is its forward axis, y its trunk towards the head. A unit
// quaternion x y z w turns the body into the world.
import { rotated } from "./spaces.js";

const LOOKS = [["face forward", 0, 1], ["backward", 0, -1], ["face up", 1, 1], ["face down", 1, -1], ["sideways", 2, 1], ["sideways", 2, -1]];
const LIES = [["head first", 0, 1], ["feet first", 0, -1], ["upright", 1, 1], ["head down", 1, -1], ["along the bar", 2, 1], ["along the bar", 2, -1]];

function nearest(axis, words) {
  return words.reduce((best, [word, at, sign]) => (axis[at] * sign > best.along ? { word, along: axis[at] * sign } : best), { along: -2 }).word;
}

export function poseName(rotation) {
  if (!Array.isArray(rotation) || rotation.length !== 4 || !rotation.every(Number.isFinite)) return null;
  const words = `${nearest(rotated([1, 0, 0], rotation), LOOKS)}, ${nearest(rotated([0, 1, 0], rotation), LIES)}`;
  return words[0].toUpperCase() + words.slice(1);
}

// For a task that tells only the angle between the forward axis and up.
export function facingName(angle) {
  const degrees = (angle * 180) / Math.PI;
  return degrees < 45 ? "Face up" : degrees < 75 ? "Half face up" : degrees <= 105 ? "Upright or sideways" : degrees <= 135 ? "Half face down" : "Face down";
}
