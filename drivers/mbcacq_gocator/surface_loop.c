/* Raw 16-bit surfaces to the points in mm, in one pass. Compiled when the package is installed, where there is a compiler; without it
   conversion.py does the same with numpy, bit for bit (hence -ffp-contract=off). No header of Python's is needed.

   raw: little endian, aligned or not. every: a pixel is valid where all its coordinates are, else where its z is. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define INVALID (-32768)

static inline int16_t at(const unsigned char *raw, size_t k)
{
    int16_t value;
    memcpy(&value, raw + 2 * k, 2);
    return value;
}

static inline int is_valid(const unsigned char *raw, size_t pixel, int every)
{
    return at(raw, 3 * pixel + 2) != INVALID && (!every || (at(raw, 3 * pixel) != INVALID && at(raw, 3 * pixel + 1) != INVALID));
}

size_t count_heights(const unsigned char *raw, size_t pixels)
{
    size_t count = 0;
    for (size_t i = 0; i < pixels; i++)
        count += at(raw, i) != INVALID;
    return count;
}

/* How many there are. points: (pixels, 3) and pixel: (pixels,), room for all. */
size_t cloud_points(const unsigned char *restrict raw, size_t pixels, int every, const float *scale, const float *offset,
                    float *restrict points, int32_t *restrict pixel)
{
    const float sx = scale[0], sy = scale[1], sz = scale[2], ox = offset[0], oy = offset[1], oz = offset[2];
    size_t k = 0;

    for (size_t i = 0; i < pixels; i++) {
        if (!is_valid(raw, i, every))
            continue;
        points[3 * k] = (float)at(raw, 3 * i) * sx + ox;
        points[3 * k + 1] = (float)at(raw, 3 * i + 1) * sy + oy;
        points[3 * k + 2] = (float)at(raw, 3 * i + 2) * sz + oz;
        pixel[k++] = (int32_t)i;
    }
    return k;
}

/* points: (count, 3), pixel: (count,), count as counted before. x: (columns,) and y: (rows,) mm of the grid; scale and offset of z. */
void height_points(const unsigned char *restrict raw, size_t rows, size_t columns, size_t count, const float *restrict x,
                   const float *restrict y, float scale, float offset, float *restrict points, int32_t *restrict pixel)
{
    size_t k = 0;

    for (size_t row = 0; row < rows; row++) {
        const unsigned char *z = raw + 2 * row * columns;
        const int32_t first = (int32_t)(row * columns);

        if (count == rows * columns) /* without a branch inside, for vectors */
            for (size_t column = 0; column < columns; column++, k++) {
                points[3 * k] = x[column];
                points[3 * k + 1] = y[row];
                points[3 * k + 2] = (float)at(z, column) * scale + offset;
                pixel[k] = first + (int32_t)column;
            }
        else
            for (size_t column = 0; column < columns && k < count; column++) {
                if (at(z, column) == INVALID)
                    continue;
                points[3 * k] = x[column];
                points[3 * k + 1] = y[row];
                points[3 * k + 2] = (float)at(z, column) * scale + offset;
                pixel[k++] = first + (int32_t)column;
            }
    }
}

void pick(const unsigned char *restrict grey, const int32_t *restrict pixel, size_t count, unsigned char *restrict picked)
{
    for (size_t k = 0; k < count; k++)
        picked[k] = grey[pixel[k]];
}
