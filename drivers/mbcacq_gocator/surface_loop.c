/* Raw 16-bit surfaces to the points in mm, in one pass. Compiled when the package is installed, where there is a compiler; without it
   conversion.py does the same with numpy, bit for bit (hence -ffp-contract=off). No header of Python's is needed.

   raw: little endian, aligned or not. every: a pixel is valid where all its coordinates are, else where its z is. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

/* Compiled twice, for any processor of its kind and for one with 256-bit vectors; which is used is seen when the library is loaded. */
#define WIDE
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__has_attribute)
#if __has_attribute(target_clones)
#undef WIDE
#define WIDE __attribute__((target_clones("avx2", "default")))
#endif
#endif

#define INVALID (-32768)
#define BLOCK 8 /* pixels converted at once */
#define RUN 16  /* grey values copied at once where their pixels follow each other */

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

WIDE size_t count_heights(const unsigned char *raw, size_t pixels)
{
    size_t count = 0;
    for (size_t i = 0; i < pixels; i++)
        count += at(raw, i) != INVALID;
    return count;
}

#ifdef __SSE2__
/* Eight pixels at once, where all of them are valid: 24 raw values make six vectors of points, of which every third has the same
   coordinates in it. */
typedef struct {
    __m128 scale[3], offset[3];
    __m128i counts[3]; /* all bits of those coordinates whose validity counts */
} Block;

static Block block_of(int every, const float *scale, const float *offset)
{
    float factor[12], shift[12];
    int16_t counts[24];
    Block b;

    for (int c = 0; c < 12; c++) {
        factor[c] = scale[c % 3];
        shift[c] = offset[c % 3];
    }
    for (int c = 0; c < 24; c++)
        counts[c] = every || c % 3 == 2 ? -1 : 0;
    for (int v = 0; v < 3; v++) {
        b.scale[v] = _mm_loadu_ps(factor + 4 * v);
        b.offset[v] = _mm_loadu_ps(shift + 4 * v);
        b.counts[v] = _mm_loadu_si128((const __m128i *)(counts + 8 * v));
    }
    return b;
}

/* 0 where one of the eight is not valid; then nothing is written. */
static inline int convert(const Block *b, const unsigned char *raw, float *points)
{
    const __m128i none = _mm_set1_epi16(INVALID);
    __m128i value[3], invalid = _mm_setzero_si128();

    for (int v = 0; v < 3; v++) {
        value[v] = _mm_loadu_si128((const __m128i *)(raw + 16 * v));
        invalid = _mm_or_si128(invalid, _mm_and_si128(_mm_cmpeq_epi16(value[v], none), b->counts[v]));
    }
    if (_mm_movemask_epi8(invalid))
        return 0;
    for (int v = 0; v < 6; v++) {
        __m128i pair = v & 1 ? _mm_unpackhi_epi16(value[v / 2], value[v / 2]) : _mm_unpacklo_epi16(value[v / 2], value[v / 2]);
        __m128 real = _mm_cvtepi32_ps(_mm_srai_epi32(pair, 16));

        _mm_storeu_ps(points + 4 * v, _mm_add_ps(_mm_mul_ps(real, b->scale[v % 3]), b->offset[v % 3]));
    }
    return 1;
}
#endif

/* How many there are. points: (pixels, 3) and pixel: (pixels,), room for all. */
size_t cloud_points(const unsigned char *restrict raw, size_t pixels, int every, const float *scale, const float *offset,
                    float *restrict points, int32_t *restrict pixel)
{
    const float sx = scale[0], sy = scale[1], sz = scale[2], ox = offset[0], oy = offset[1], oz = offset[2];
    size_t k = 0, i = 0;
#ifdef __SSE2__
    const Block block = block_of(every, scale, offset);
#endif

    while (i < pixels) {
        size_t end = i + BLOCK < pixels ? i + BLOCK : pixels;

#ifdef __SSE2__
        if (end - i == BLOCK && convert(&block, raw + 6 * i, points + 3 * k)) {
            for (int c = 0; c < BLOCK; c++)
                pixel[k + c] = (int32_t)(i + c);
            k += BLOCK;
            i = end;
            continue;
        }
#endif
        for (; i < end; i++) {
            if (!is_valid(raw, i, every))
                continue;
            points[3 * k] = (float)at(raw, 3 * i) * sx + ox;
            points[3 * k + 1] = (float)at(raw, 3 * i + 1) * sy + oy;
            points[3 * k + 2] = (float)at(raw, 3 * i + 2) * sz + oz;
            pixel[k++] = (int32_t)i;
        }
    }
    return k;
}

/* points: (count, 3), pixel: (count,), count as counted before. x: (columns,) and y: (rows,) mm of the grid; scale and offset of z. */
WIDE void height_points(const unsigned char *restrict raw, size_t rows, size_t columns, size_t count, const float *restrict x,
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

/* pixel: ascending, each once. */
void pick(const unsigned char *restrict grey, const int32_t *restrict pixel, size_t count, unsigned char *restrict picked)
{
    size_t k = 0;

    while (k < count)
        if (k + RUN <= count && pixel[k + RUN - 1] - pixel[k] == RUN - 1) {
            memcpy(picked + k, grey + pixel[k], RUN);
            k += RUN;
        } else {
            picked[k] = grey[pixel[k]];
            k++;
        }
}
