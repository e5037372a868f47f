document.querySelectorAll('.legend input').forEach(box => box.addEventListener('change', () => {
  document.querySelectorAll(`svg.curves [data-method="${box.value}"], .curves svg [data-method="${box.value}"]`)
    .forEach(line => { line.style.display = box.checked ? '' : 'none'; });
}));
const compare = document.querySelector('.compare');
if (compare) {
  const crops = JSON.parse(document.getElementById('crops').textContent);
  const pick = id => document.getElementById(id);
  const [frame, left, right] = ['frame', 'left', 'right'].map(pick);
  const [under, over] = compare.querySelectorAll('img');
  const edge = compare.querySelector('.edge');
  const names = compare.querySelectorAll('span');
  const fill = (select, chosen) => {
    const known = Object.keys(crops[frame.value]);
    select.replaceChildren(...known.map(name => new Option(name, name)));
    select.value = known.includes(chosen) ? chosen : known[known.length - 1];
  };
  const show = () => {
    over.src = 'data:image/png;base64,' + crops[frame.value][left.value];
    under.src = 'data:image/png;base64,' + crops[frame.value][right.value];
    names[0].textContent = left.value;
    names[1].textContent = right.value;
  };
  const choose = () => { const chosen = [left.value, right.value]; fill(left, chosen[0]); fill(right, chosen[1]); show(); };
  const move = share => {
    const percent = Math.min(Math.max(share, 0), 1) * 100;
    over.style.clipPath = `inset(0 ${100 - percent}% 0 0)`;
    edge.style.left = percent + '%';
  };
  const drag = event => {
    const box = compare.getBoundingClientRect();
    move((event.clientX - box.left) / box.width);
  };
  frame.addEventListener('change', choose);
  [left, right].forEach(select => select.addEventListener('change', show));
  compare.addEventListener('pointerdown', event => { compare.setPointerCapture(event.pointerId); drag(event); });
  compare.addEventListener('pointermove', event => { if (event.buttons || event.pointerType === 'mouse') drag(event); });
  fill(left, compare.dataset.left);
  fill(right, compare.dataset.right);
  show();
  move(0.5);
}
