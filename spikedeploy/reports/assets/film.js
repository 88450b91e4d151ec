// Pictures that an environment drew of itself, each until the next one is nearer.

class FilmView {
  constructor(episode) {
    this.episode = episode;
    this.zoom = 1;
  }

  turn() {}

  draw(context, width, height, step, paint) {
    const { film, scene } = this.episode;
    const picture = film[Math.min(film.length - 1, Math.round(step / scene.every))];
    const scale = Math.min(width / picture.width, height / picture.height);
    const wide = picture.width * scale, high = picture.height * scale;
    context.fillStyle = paint.sky;
    context.fillRect(0, 0, width, height);
    context.drawImage(picture, (width - wide) / 2, (height - high) / 2, wide, high);
  }
}

async function pictureOf(text) {
  const picture = new Image();
  picture.src = `data:image/webp;base64,${text}`;
  await picture.decode();
  return picture;
}
