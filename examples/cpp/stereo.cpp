// Disparity of a rectified pair, from a file that `msnet export openvino` wrote.
//
//   stereo MODEL.xml LEFT.png RIGHT.png DISPARITY.png [CONFIDENCE.png]
//
// DISPARITY.png holds 256 times the disparity in px as 16-bit values, 0 where it is unknown (the
// format of KITTI); CONFIDENCE.png holds 0..255.

#include <png.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <iostream>
#include <memory>
#include <openvino/openvino.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

struct Image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgb;  // row by row
};

struct Size {
  int width;
  int height;
};

Image read_png(const std::string& path) {
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  if (!png_image_begin_read_from_file(&png, path.c_str()))
    throw std::runtime_error(path + ": " + png.message);
  png.format = PNG_FORMAT_RGB;
  Image image{static_cast<int>(png.width), static_cast<int>(png.height), {}};
  image.rgb.resize(PNG_IMAGE_SIZE(png));
  const png_color black{};
  if (!png_image_finish_read(&png, &black, image.rgb.data(), 0, nullptr))
    throw std::runtime_error(path + ": " + png.message);
  return image;
}

// Writes rows of grey values of 8 or 16 bits, most significant byte first.
void write_png(const std::string& path, Size size, int bits, std::vector<std::uint8_t> bytes) {
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "wb"), std::fclose);
  if (!file) throw std::runtime_error(path + ": cannot be written");
  const auto fail = [](png_structp, png_const_charp text) { throw std::runtime_error(text); };
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, fail, nullptr);
  png_infop info = png_create_info_struct(png);
  png_init_io(png, file.get());
  png_set_IHDR(png, info, size.width, size.height, bits, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  const std::size_t stride = static_cast<std::size_t>(size.width) * bits / 8;
  for (int y = 0; y < size.height; ++y) png_write_row(png, bytes.data() + y * stride);
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
}

// What the file says about itself under a name.
std::string metadata(const ov::Model& model, const std::string& name) {
  if (!model.has_rt_info("mobilestereonet", name))
    throw std::runtime_error("the model does not tell its " + name +
                             ": it must come from `msnet export openvino`");
  return model.get_rt_info<std::string>("mobilestereonet", name);
}

void expect(const ov::Model& model, const std::string& name, const std::string& start) {
  const std::string found = metadata(model, name);
  if (found.rfind(start, 0) != 0)
    throw std::runtime_error("the model's " + name + " is " + found + ", not " + start);
}

int round_up(int value, int multiple) { return (value + multiple - 1) / multiple * multiple; }

// Size to which a view is padded for the model.
Size padded_size(const ov::Model& model, const Image& view) {
  const std::string size = metadata(model, "size");
  if (size == "any") {
    const int multiple = std::stoi(metadata(model, "size_multiple"));
    const int least = std::stoi(metadata(model, "smallest_width"));
    return {round_up(std::max(view.width, least), multiple), round_up(view.height, multiple)};
  }
  Size fixed{};
  if (std::sscanf(size.c_str(), "%d x %d", &fixed.height, &fixed.width) != 2)
    throw std::runtime_error("the model's size is " + size);
  if (view.width > fixed.width || view.height > fixed.height)
    throw std::runtime_error("the views are larger than the model's " + size);
  return fixed;
}

// A view as the model's input: RGB in 0..1, padded above and on the right with its border's pixels.
ov::Tensor to_tensor(const Image& view, Size size) {
  ov::Tensor tensor(ov::element::f32, {1, 3, std::size_t(size.height), std::size_t(size.width)});
  float* value = tensor.data<float>();
  const int above = size.height - view.height;
  for (int channel = 0; channel < 3; ++channel)
    for (int y = 0; y < size.height; ++y) {
      const std::uint8_t* row = &view.rgb[std::size_t(3) * view.width * std::max(0, y - above)];
      for (int x = 0; x < size.width; ++x)
        *value++ = row[3 * std::min(x, view.width - 1) + channel] / 255.0F;
    }
  return tensor;
}

// The part of a map (1, height, width) that belongs to the view.
std::vector<float> crop(const ov::Tensor& map, const Image& view) {
  const int height = map.get_shape()[1], width = map.get_shape()[2];
  const float* values = map.data<const float>();
  std::vector<float> cropped;
  for (int y = height - view.height; y < height; ++y)
    cropped.insert(cropped.end(), values + y * width, values + y * width + view.width);
  return cropped;
}

void run(const std::vector<std::string>& paths) {
  ov::Core core;
  const auto model = core.read_model(paths[0]);
  expect(*model, "colour_order", "RGB");
  expect(*model, "value_range", "0..1");
  expect(*model, "normalisation", "inside the graph");
  expect(*model, "padding", "above and on the right");

  const Image left = read_png(paths[1]), right = read_png(paths[2]);
  if (left.width != right.width || left.height != right.height)
    throw std::runtime_error("the views differ in size");
  const Size padded = padded_size(*model, left), size{left.width, left.height};

  // Some processors would compute in bfloat16 by themselves.
  auto compiled = core.compile_model(model, "CPU", ov::hint::inference_precision(ov::element::f32));
  auto request = compiled.create_infer_request();
  request.set_tensor("left", to_tensor(left, padded));
  request.set_tensor("right", to_tensor(right, padded));
  request.infer();

  std::vector<std::uint8_t> bytes;
  for (const float disparity : crop(request.get_tensor("disparity"), left)) {
    const long level = std::lround(256.0F * disparity);
    const long stored = level >= 0 && level <= 65535 ? level : 0;
    bytes.push_back(static_cast<std::uint8_t>(stored >> 8));
    bytes.push_back(static_cast<std::uint8_t>(stored & 255));
  }
  write_png(paths[3], size, 16, bytes);
  if (paths.size() < 5) return;
  bytes.clear();
  for (const float confidence : crop(request.get_tensor("confidence"), left))
    bytes.push_back(static_cast<std::uint8_t>(std::lround(255.0F * confidence)));
  write_png(paths[4], size, 8, bytes);
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 5 || count > 6) {
    std::cerr << "usage: stereo MODEL.xml LEFT.png RIGHT.png DISPARITY.png [CONFIDENCE.png]\n";
    return 2;
  }
  try {
    run({arguments + 1, arguments + count});
  } catch (const std::exception& error) {
    std::cerr << "stereo: " << error.what() << '\n';
    return 1;
  }
  return 0;
}
