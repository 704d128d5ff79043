/* A Gocator surface to points in mm, in one pass of a C loop: the comparison of benchmarks/speed.py gocator.
   cc -O3 -march=native -shared -fPIC -o gocator_decode.so gocator_decode.c

   Each function does the work of the driver: of every valid pixel the point (3 float32, mm), the index (int32) and, where ``grey`` is not
   NULL, the grey value; it returns how many there are. points, pixel, intensity: room for every pixel. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

#define INVALID (-32768)
#define CLOUD 28
#define HEIGHTS 8
#define GREY 9

static size_t cloud(const int16_t *raw, const uint8_t *grey, size_t pixels, const float *scale, const float *offset, float *points,
                    int32_t *pixel, uint8_t *intensity)
{
    size_t count = 0;
    const float sx = scale[0], sy = scale[1], sz = scale[2], ox = offset[0], oy = offset[1], oz = offset[2];

    for (size_t i = 0; i < pixels; i++) {
        const int16_t *from = raw + 3 * i;
        float *to = points + 3 * count;

        if (from[2] == INVALID)
            continue;
        to[0] = from[0] * sx + ox;
        to[1] = from[1] * sy + oy;
        to[2] = from[2] * sz + oz;
        pixel[count] = (int32_t)i;
        if (grey != NULL)
            intensity[count] = grey[i];
        count++;
    }
    return count;
}

static size_t heights(const int16_t *raw, const uint8_t *grey, size_t length, size_t width, const float *scale, const float *offset,
                      float *points, int32_t *pixel, uint8_t *intensity)
{
    size_t count = 0;
    const float sx = scale[0], sy = scale[1], sz = scale[2], ox = offset[0], oy = offset[1], oz = offset[2];

    for (size_t row = 0; row < length; row++) {
        const float y = row * sy + oy;

        for (size_t column = 0; column < width; column++) {
            const size_t i = row * width + column;
            float *to = points + 3 * count;

            if (raw[i] == INVALID)
                continue;
            to[0] = column * sx + ox;
            to[1] = y;
            to[2] = raw[i] * sz + oz;
            pixel[count] = (int32_t)i;
            if (grey != NULL)
                intensity[count] = grey[i];
            count++;
        }
    }
    return count;
}

/* width 0: a point cloud of ``length`` pixels, else a height map. */
static size_t decode(const int16_t *raw, const uint8_t *grey, size_t length, size_t width, const float *scale, const float *offset,
                     float *points, int32_t *pixel, uint8_t *intensity)
{
    return width == 0 ? cloud(raw, grey, length, scale, offset, points, pixel, intensity)
                      : heights(raw, grey, length, width, scale, offset, points, pixel, intensity);
}

size_t into_kept(const int16_t *raw, const uint8_t *grey, size_t length, size_t width, const float *scale, const float *offset,
                 float *points, int32_t *pixel, uint8_t *intensity)
{
    return decode(raw, grey, length, width, scale, offset, points, pixel, intensity);
}

/* The same into memory that is allocated for it, and freed again. */
size_t into_new(const int16_t *raw, const uint8_t *grey, size_t length, size_t width, const float *scale, const float *offset)
{
    const size_t pixels = length * (width ? width : 1);
    float *points = malloc(12 * pixels);
    int32_t *pixel = malloc(4 * pixels);
    uint8_t *intensity = grey ? malloc(pixels) : NULL;
    size_t count = decode(raw, grey, length, width, scale, offset, points, pixel, intensity);

    free(points);
    free(pixel);
    free(intensity);
    return count;
}

/* Every pixel, NaN where there is none, and no index: less than the driver does. */
void with_nan(const int16_t *raw, const uint8_t *grey, size_t length, size_t width, const float *scale, const float *offset, float *points)
{
    const size_t columns = width ? width : length, rows = width ? length : 1;
    const float sx = scale[0], sy = scale[1], sz = scale[2], ox = offset[0], oy = offset[1], oz = offset[2];

    (void)grey;
    for (size_t row = 0; row < rows; row++)
        for (size_t column = 0; column < columns; column++) {
            const size_t i = row * columns + column;
            const int16_t z = width ? raw[i] : raw[3 * i + 2];
            float *to = points + 3 * i;

            to[0] = z == INVALID ? NAN : (width ? (float)column : (float)raw[3 * i]) * sx + ox;
            to[1] = z == INVALID ? NAN : (width ? (float)row : (float)raw[3 * i + 1]) * sy + oy;
            to[2] = z == INVALID ? NAN : z * sz + oz;
        }
}

/* One data set from a socket into ``buffer``, decoded into new memory that is freed again: the whole way of a frame. -1: it broke off. */
long received(int fd, uint8_t *buffer, size_t room, size_t length, size_t width, const float *scale, const float *offset)
{
    const int16_t *raw = NULL;
    const uint8_t *grey = NULL;
    size_t used = 0, have = 0;

    for (;;) {
        uint32_t size;
        uint16_t control, attributes;

        while (have < used + 8 || have < used + (memcpy(&size, buffer + used, 4), size)) {
            ssize_t got = recv(fd, buffer + have, room - have, 0);
            if (got <= 0)
                return -1;
            have += (size_t)got;
        }
        memcpy(&control, buffer + used + 4, 2);
        memcpy(&attributes, buffer + used + 6, 2);
        if ((control & 0x7FFF) == CLOUD || (control & 0x7FFF) == HEIGHTS)
            raw = (const int16_t *)(buffer + used + 8 + attributes);
        if ((control & 0x7FFF) == GREY)
            grey = buffer + used + 8 + attributes;
        used += size;
        if (control & 0x8000)
            return raw ? (long)into_new(raw, grey, length, width, scale, offset) : -1;
    }
}
