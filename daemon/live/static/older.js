// What browsers of 2020 to 2022 lack: Chrome before 97, Firefox before 104, Safari before 15.4.

function add(name, value) {
  if (!(name in Array.prototype)) Object.defineProperty(Array.prototype, name, { value, configurable: true });
}

add("at", function (index) {
  return this[index < 0 ? this.length + index : index];
});
add("findLast", function (holds) {
  return this.slice().reverse().find(holds);
});
